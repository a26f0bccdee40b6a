"""A run in a process of its own ends with the process that started it."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

from vprbench import sweep


def test_a_run_apart_is_given_its_options_and_told_that_it_is_one_of_many(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def run(command: list[str], **options: object) -> subprocess.CompletedProcess[str]:
        asked.append((command, options["env"]))
        return subprocess.CompletedProcess(command, 3, "said")

    monkeypatch.setattr(subprocess, "run", run)
    done = sweep.run_apart(["method=sad", "seed=1"])
    ((command, environment),) = asked
    assert (done.returncode, done.stdout) == (3, "said")
    assert command == [sys.executable, "-m", "vprbench", "method=sad", "seed=1"]
    assert isinstance(environment, dict)
    assert environment[sweep.IN_SWEEP] == "1"


def test_being_told_to_end_is_an_exception_while_a_run_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    before = signal.getsignal(signal.SIGTERM)
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: signal.raise_signal(signal.SIGTERM))
    with pytest.raises(SystemExit) as ended:
        sweep.run_apart([])
    assert ended.value.code == 128 + signal.SIGTERM
    assert signal.getsignal(signal.SIGTERM) is before
