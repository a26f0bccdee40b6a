"""Runs in processes of their own: how each ended is known, whatever became of it, and it ends with who started it."""

from __future__ import annotations

import json
import signal
import sys
import tempfile
from itertools import product
from pathlib import Path

import pytest

from vprbench import cli
from vprbench.cluster import crew
from vprbench.run import processes
from vprbench.run.processes import Ending
from vprbench.run.store import Store

RUN = {"method": "little", "dataset": "journey", "config": {"seed": 4}}
GOOD = '{"code": 0}'


@pytest.fixture
def ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Return what runs a script in place of the command line, and says how it ended."""

    def run(script: str, *arguments: str) -> Ending:
        program = tmp_path / "program"
        program.write_text(f"#!/bin/sh\n{script}\n")
        program.chmod(0o700)
        monkeypatch.setattr(sys, "executable", str(program))
        return processes.run_apart(arguments)

    return run


def test_a_run_apart_is_given_its_options_and_told_that_it_is_one_of_many(ends, tmp_path: Path) -> None:
    asked = tmp_path / "asked"
    script = f"""echo "$@" "$VPRBENCH_IN_SWEEP" > {asked}; echo '{GOOD}' > "$VPRBENCH_ENDING" """
    assert ends(script, "method=sad", "seed=1") == Ending(0)
    assert asked.read_text().split()[-5:] == ["-m", "vprbench", "method=sad", "seed=1", "1"]


@pytest.mark.skipif(sys.platform != "linux", reason="files without a name that another process opens")
def test_a_run_apart_has_no_temporary_file_that_a_kill_could_leave(
    ends, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    script = f"""ls -A {temporary} > {tmp_path}/seen; echo '{GOOD}' > "$VPRBENCH_ENDING" """
    assert ends(script) == Ending(0)
    assert (tmp_path / "seen").read_text() == ""


@pytest.mark.parametrize(
    ("script", "code", "words"),
    [
        ("exit 0", 1, "exit code 0"),
        ("exit 3", 1, "exit code 3"),
        ("kill -KILL $$", 1, "signal 9 (SIGKILL)"),
        ("kill -SEGV $$", 1, "signal 11 (SIGSEGV)"),
        (f"""echo '{GOOD[:-1]}' > "$VPRBENCH_ENDING" """, 1, "exit code 0"),  # died while it wrote
        (f"""echo '{GOOD}' > "$VPRBENCH_ENDING"; kill -SEGV $$""", 0, ""),  # died after all was done
        ("""echo '{"code": 2, "error": "no frames", "missing": true}' > "$VPRBENCH_ENDING"; exit 2""", 2, "no frames"),
    ],
)
def test_what_a_process_said_counts_and_one_that_said_nothing_has_failed(
    ends, script: str, code: int, words: str, capfd: pytest.CaptureFixture[str]
) -> None:
    ending = ends(script)
    assert (ending.code, ending.missing) == (code, code == 2)
    assert ending.error.endswith(words) or words in ending.error
    assert len(capfd.readouterr().err.splitlines()) == (code == 1)


def test_a_run_that_dies_is_a_stored_failure_with_its_signal(
    ends, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    begun = {"run": RUN, "results": str(tmp_path / "results"), "threads": 1, "output": "json"}
    (tmp_path / "begun").write_text(json.dumps(begun))
    ending = ends(f"""cat {tmp_path}/begun > "$VPRBENCH_ENDING"; kill -BUS $$""")
    assert (ending.code, ending.recorded) == (1, True)
    (failure,) = Store(tmp_path / "results").failures()
    assert (failure.method, failure.dataset, failure.config["seed"]) == ("little", "journey", 4)
    assert "SIGBUS" in failure.error
    assert json.loads(capfd.readouterr().out)["error"] == failure.error


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_being_told_to_end_ends_the_process_too(ends, number: signal.Signals) -> None:
    before = signal.getsignal(number)
    with pytest.raises(KeyboardInterrupt) as ended:
        ends(f"kill -{number.name.removeprefix('SIG')} $PPID; exec sleep 20")
    assert ended.value.args == (number,)
    assert signal.getsignal(number) is before


@pytest.mark.parametrize("in_sweep", [True, False])
def test_an_interruption_is_told_once_by_the_process_that_was_asked(
    in_sweep: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt() -> None:
        raise KeyboardInterrupt(signal.SIGTERM)

    monkeypatch.setattr(cli.registry, "register_search_path", interrupt)
    monkeypatch.setenv(processes.IN_SWEEP, "1" if in_sweep else "")
    assert cli.main(["method=sad"]) == 128 + signal.SIGTERM
    assert len(capsys.readouterr().err.splitlines()) == (not in_sweep)


def test_an_option_of_a_sweep_goes_to_each_of_its_methods(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    asked: list[list[str]] = []
    monkeypatch.setattr(crew, "run_apart", lambda options, **_: asked.append(list(options)) or Ending(len(asked) % 2))
    monkeypatch.chdir(tmp_path)
    methods, places = ["vprtempo", "vprtempo_int8"], "dataset.references=[a,b]"
    swept = [f"method={','.join(methods)}", "method.rules=paper,reference", "method.max_module=921"]
    assert cli.main([*swept, "-m", "dataset=nordland_64x32", "seed=0,1", places]) == 1
    assert [options[:3] for options in asked] == [
        [f"method={method}", f"method.rules={rules}", "method.max_module=921"]
        for method, rules, _ in product(methods, ("paper", "reference"), (0, 1))
    ]
    assert all(places in options and "dataset=nordland_64x32" in options for options in asked)
    assert [options[4] for options in asked] == ["seed=0", "seed=1"] * 4
    assert [record.name for record in caplog.records] == ["vprbench.cluster.sweep"] * 8  # none of Hydra's
