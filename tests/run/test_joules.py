"""Joules by a made-up powercap: wrapped counters, idle power, and what cannot be read."""

from __future__ import annotations

from pathlib import Path

import pytest

from vprbench.run import joules

MOST = 1_000_000  # microjoules, where the made-up counters wrap around


def powercap(root: Path, **microjoules: int) -> Path:
    """Make counters `package`, `dram` and `core` as Linux has them: the last is part of the first."""
    for zone, (name, value) in enumerate(microjoules.items()):
        folder = root / ("intel-rapl:0" if name == "package" else f"intel-rapl:0:{zone}")
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "name").write_text("package-0\n" if name == "package" else f"{name}\n")
        (folder / "max_energy_range_uj").write_text(f"{MOST}\n")
        (folder / "energy_uj").write_text(f"{value}\n")
    return root


def test_package_and_memory_are_added_over_a_wrap_and_what_lies_within_a_package_is_not(tmp_path: Path) -> None:
    source, read = joules.rapl(powercap(tmp_path, package=900_000, dram=10, core=5))
    powercap(tmp_path, package=100_000, dram=50_010, core=400_000)
    assert "package-0" in source
    assert read() == pytest.approx(0.25)
    powercap(tmp_path, package=50_000, dram=50_010, core=0)  # around once more
    assert read() == pytest.approx(1.2)


def test_idle_power_is_subtracted_from_what_queries_take() -> None:
    now, spent = 0.0, 100.0

    def passes(seconds: float, watts: float) -> None:
        nonlocal now, spent
        now, spent = now + seconds, spent + seconds * watts

    found = joules.measured(lambda: spent, lambda: passes(0.5, 30), lambda: now, lambda seconds: passes(seconds, 10))
    assert found == pytest.approx({"joules": 10, "watts": 30, "idle_watts": 10, "queries": 4, "seconds": 2})


def test_a_query_longer_than_the_window_is_asked_once() -> None:
    now = 0.0

    def passes(seconds: float) -> None:
        nonlocal now
        now += seconds

    found = joules.measured(lambda: 2 * now, lambda: passes(7), lambda: now, passes)
    assert (found["queries"], found["seconds"], found["joules"]) == (1, 7, 0)


@pytest.mark.parametrize("broken", ["nothing", "no package", "unreadable"])
def test_what_cannot_be_read_is_told(tmp_path: Path, broken: str) -> None:
    if broken == "no package":
        powercap(tmp_path, core=5)
    if broken == "unreadable":
        (powercap(tmp_path, package=5) / "intel-rapl:0" / "energy_uj").write_text("denied")
    with pytest.raises(joules.UnreadableError, match=str(tmp_path)):
        joules.rapl(tmp_path)


def test_a_gpu_without_its_driver_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise OSError(f"{name} is not there")

    monkeypatch.setattr(joules.ctypes, "CDLL", missing)
    with pytest.raises(joules.UnreadableError, match="NVML"):
        joules.nvml("cuda")
