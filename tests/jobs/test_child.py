"""A run in a process of its own: its request and its result are files, and each death is named."""

import json
import signal
import sys
import tempfile
from dataclasses import replace

import pytest

from vprbench import cli
from vprbench.jobs import child, executors
from vprbench.jobs.job import JobResult
from vprbench.runs.request import RunRequest
from vprbench.runs.store import Store

GOOD = json.dumps({"code": 0, "key": "abc"})
LEAVE = """echo '%s' > "$place/result.json" """
LINE = '  File "mine.py", line 3 in fit'
SAD = RunRequest("sad", {}, "journey", {"name": "journey"})


@pytest.fixture
def ends(tmp_path, monkeypatch):
    """Return a function that runs a script in place of the command line, and says how it ended."""

    def run(script, *arguments, **changes):
        program = tmp_path / "program"
        program.write_text(f"#!/bin/sh\nfor last; do place=$before; before=$last; done\n{script}\n")
        program.chmod(0o700)
        monkeypatch.setattr(sys, "executable", str(program))
        request = replace(SAD, results=str(tmp_path / "results"), **changes)
        return child.run_in_child(request.to_json(), *arguments)

    return run


def test_a_request_and_a_result_are_files_lines_are_passed_on_and_no_temporary_file_stays(ends, tmp_path, monkeypatch):
    temporary, said = tmp_path / "temporary", []
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    script = f'cp "$place/request.json" {tmp_path}/asked; echo one >&2; printf two >&2; {LEAVE % GOOD}'
    assert ends(script, said.append, seed=1) == JobResult(0, key="abc")
    asked = RunRequest.from_json((tmp_path / "asked").read_text())
    assert (asked.method_name, asked.seed, said) == ("sad", 1, ["one", "two"])
    assert [*temporary.iterdir()] == []


@pytest.mark.parametrize(
    ("script", "code", "words"),
    [
        ("exit 0", 1, "with exit code 0"),
        ("echo no room >&2; exit 3", 1, "with exit code 3: no room"),
        (f"echo '{LINE}' >&2; echo more >&2; kill -SEGV $$", 1, f"by signal 11 (SIGSEGV): {LINE.strip()}"),
        ("kill -KILL $$", 1, "for want of memory"),
        (f"{LEAVE % GOOD}; kill -SEGV $$", 0, ""),  # died after all was done
        (LEAVE % json.dumps({"code": 2, "error": "no frames", "missing": True}), 2, "no frames"),
    ],
)
def test_the_result_of_a_process_counts_and_a_process_without_one_has_failed(ends, script, code, words, capfd):
    result = ends(script)
    assert (result.code, result.missing, words in result.error) == (code, code == 2, True)
    assert capfd.readouterr().err.count("vprbench: sad ") == (code == 1)


def test_a_process_is_ended_at_its_limit_or_soon_after_its_result(ends, monkeypatch):
    monkeypatch.setattr(child, "_PATIENCE", 0.2)
    assert "limit_minutes=0.005" in ends("exec sleep 20", limit_minutes=0.005).error
    assert ends(f"{LEAVE % GOOD}; exec sleep 20").key == "abc"  # as one that waits for children of a plug-in
    assert ends(f"(sleep 20; echo late >&2) & {LEAVE % GOOD}").key == "abc"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_an_interruption_of_the_one_who_asked_ends_the_process_too(ends, number, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt(number)

    monkeypatch.setattr(child, "_PATIENCE", 1.0)
    before = signal.signal(number, interrupt)
    try:
        with pytest.raises(KeyboardInterrupt) as ended:
            ends(f"sleep 0.5; kill -{number.name.removeprefix('SIG')} $PPID; exec sleep 20")
    finally:
        signal.signal(number, before)
    assert ended.value.args == (number,)


@pytest.mark.parametrize(("script", "words"), [("", "SIGINT"), ("trap '' INT", "SIGKILL")])
def test_a_job_that_is_stopped_is_interrupted_and_ended_if_it_does_not_listen(
    ends, script, words, monkeypatch, tmp_path
):
    monkeypatch.setattr(child, "_PATIENCE", 0.5)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # the script inherits no deafness
    try:
        script = f"{script}\ntouch {tmp_path}/ready; exec sleep 20"
        assert words in ends(script, None, (tmp_path / "ready").exists).error
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_sweep_makes_a_request_for_each_combination_and_stores_a_run_whose_process_dies_as_a_failure(
    tmp_path, monkeypatch, capsys
):
    asked = []
    dead = JobResult(1, "was ended by signal 7 (SIGBUS)")
    monkeypatch.setattr(executors, "run_in_child", lambda text, *_: asked.append(RunRequest.from_json(text)) or dead)
    monkeypatch.chdir(tmp_path)
    options = ["method.max_module=921", "-m", "seed=0,1", "dataset=folders", "dataset.references=[a,b]", "output=json"]
    assert cli.main(["method=vprtempo,vprtempo_int8", *options]) == 1
    wanted = [(method, seed) for method in ("vprtempo", "vprtempo_int8") for seed in (0, 1)]
    assert [(request.method_name, request.seed) for request in asked] == wanted
    assert all(request.changed == {"max_module": 921} for request in asked)
    assert all(request.dataset["references"] == ["a", "b"] for request in asked)
    stored = [*Store(tmp_path / "results").failures()]
    assert sorted((failure.method, failure.config["seed"]) for failure in stored) == wanted
    told = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [row["error"] for row in told] == [dead.error] * 4 == [failure.error for failure in stored]


def test_of_several_runs_a_bad_one_is_refused_before_any_is_made(monkeypatch, capsys):
    monkeypatch.setattr(executors, "run_in_child", lambda *_: pytest.fail("it ran"))
    assert cli.main(["-m", "method=vprtempo,sad", "method.rules=paper"]) == 2
    assert "method.rules is unknown to sad" in capsys.readouterr().err
