"""A job is made in a process of its own: what it is asked, what it leaves, and how each death is named."""

import json
import signal
import sys
import tempfile

import pytest

from vprbench import cli
from vprbench.jobs import child, executors, job
from vprbench.jobs.job import Job, JobResult
from vprbench.runs.store import Store

GOOD = json.dumps({"code": 0, "key": "abc"})
LEAVE = """echo '%s' > "$VPRBENCH_JOB/result.json" """
LINE = '  File "mine.py", line 3 in fit'


@pytest.fixture
def ends(tmp_path, monkeypatch):
    """Return what runs a script in place of the command line, and says how it ended."""

    def run(script, *options, **given):
        program = tmp_path / "program"
        program.write_text(f"#!/bin/sh\n{script}\n")
        program.chmod(0o700)
        monkeypatch.setattr(sys, "executable", str(program))
        return child.run_job([*options, f"results={tmp_path / 'results'}"], **given)

    return run


def test_a_job_is_asked_in_a_file_and_leaves_its_result_there_its_lines_with_us_and_no_temporary_file(
    ends, tmp_path, monkeypatch
):
    temporary, said = tmp_path / "temporary", []
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    script = f"""cat "$VPRBENCH_JOB/job.json" "$VPRBENCH_JOB" > {tmp_path}/asked; echo one >&2; {LEAVE % GOOD}"""
    assert ends(script, "method=sad", "seed=1", heard=said.append) == JobResult(0, key="abc")
    asked = json.loads((tmp_path / "asked").read_text())
    assert asked["options"][:2] == ["method=sad", "seed=1"]
    assert [line for line in said if not line.startswith("cat")] == ["one"]
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
def test_what_a_process_left_counts_and_a_process_that_left_nothing_has_failed(ends, script, code, words, capfd):
    result = ends(script, "method=sad")
    assert (result.code, result.missing, words in result.error) == (code, code == 2, True)
    assert capfd.readouterr().err.count("vprbench: method=sad ") == (code == 1)


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
        assert words in ends(script, stopped=(tmp_path / "ready").exists).error
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("as_job", [True, False])
def test_an_interruption_is_told_once_by_the_process_that_was_asked(as_job, monkeypatch, capsys):
    def interrupt():
        raise KeyboardInterrupt(signal.SIGTERM)

    monkeypatch.setattr(cli.registry, "register_search_path", interrupt)
    monkeypatch.setattr(job, "current", Job() if as_job else None)
    assert cli.main(["method=sad"]) == 128 + signal.SIGTERM
    assert len(capsys.readouterr().err.splitlines()) == (not as_job)


def test_an_option_of_a_sweep_goes_to_each_of_its_methods_and_a_run_whose_process_dies_is_a_stored_failure(
    tmp_path, monkeypatch, capsys
):
    asked = []
    dead = JobResult(1, error="was ended by signal 7 (SIGBUS)")
    monkeypatch.setattr(executors, "run_job", lambda options, **_: asked.append(list(options)) or dead)
    monkeypatch.chdir(tmp_path)
    places = "dataset.references=[a,b]"
    options = ["method.max_module=921", "-m", "seed=0,1", places, "output=json"]
    assert cli.main(["method=vprtempo,vprtempo_int8", *options]) == 1
    assert [options[:3] for options in asked] == [
        [f"method={method}", "method.max_module=921", f"seed={seed}"]
        for method in ("vprtempo", "vprtempo_int8")
        for seed in (0, 1)
    ]
    assert all(places in options for options in asked)
    stored = [*Store(tmp_path / "results").failures()]
    assert {(failure.method, failure.config["seed"]) for failure in stored} == {
        (method, seed) for method in ("vprtempo", "vprtempo_int8") for seed in (0, 1)
    }
    told = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [row["error"] for row in told] == [dead.error] * 4 == [failure.error for failure in stored]
