"""Tests of a GPU beside the CPU: `make gpu-check` measures at full size and writes results/gpu.md, tests run small.

Small ones also run with the CPU in the place of the GPU, so that every comparison runs everywhere.
"""

import pytest
import torch
from full_size import FULL
from measuring import all_cores, build, measure, route, size

__all__ = ["all_cores", "build", "measure", "route", "size"]

MISSING = f"PyTorch {torch.__version__} sees no CUDA device"


def pytest_configure():
    """Refuse to measure at full size where there is no GPU."""
    if FULL and not torch.cuda.is_available():
        raise pytest.UsageError(MISSING)


@pytest.fixture(scope="module", params=["cuda"] if FULL else ["cpu", "cuda"])
def device(request):
    """Return the device that is compared with the CPU."""
    if request.param == "cuda" and not torch.cuda.is_available():
        pytest.skip(MISSING)
    return request.param
