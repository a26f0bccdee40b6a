"""Benchmarks of speed: `make bench` measures at full size and writes results/bench.md, tests run each once, small."""

import pytest
import torch
from measuring import all_cores, build, measure, route, size

__all__ = ["all_cores", "build", "measure", "route", "size"]


def pytest_collection_modifyitems(items):
    for item in items:
        if item.path.parent.name == "benchmarks":
            item.add_marker(pytest.mark.extended)


@pytest.fixture(scope="session")
def reads():
    """Return what reads, or reads and writes, so many bytes with all threads: what no method can be faster than."""

    def floor(n_bytes, write=False):
        buffer = torch.ones(max(1, n_bytes // 4))
        touch = (lambda: buffer.mul_(1.0)) if write else buffer.sum
        return {f"{'pass over' if write else 'read of'} {n_bytes / 1e6:,.3g} MB": touch}

    return floor
