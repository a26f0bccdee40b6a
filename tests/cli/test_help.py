"""Help, lists and completion: each option by its name, default and meaning, found without PyTorch or a plug-in."""

import json
import os
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest
from checkout import ROOT

from vprbench import __version__
from vprbench.cli import main
from vprbench.commands.catalogue import COMMANDS
from vprbench.plugins import registry
from vprbench.runs.request import OPTIONS

OF_RUNS = {*OPTIONS} - {"method", "dataset", "timing"}  # but those that name a yaml


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("COLUMNS", raising=False)


def printed(capsys, *arguments):
    assert main(arguments) == 0
    return capsys.readouterr().out


def helped(capsys, *arguments):
    """The lines of a help by their options: option, default and meaning."""
    lines = printed(capsys, *arguments, "--help").splitlines()[2:]
    assert max(map(len, lines), default=0) <= 100
    return {line.split()[0]: line.split(maxsplit=2) for line in lines if line.strip()}


@pytest.mark.parametrize("line", ["", "--version", "list spiking", "compare --help", "__complete v m"])
def test_nothing_that_is_printed_at_once_imports_pytorch_or_a_plug_in(line):
    heavy = {"torch", "matplotlib", "optuna", "hydra", "omegaconf", "numpy", "pydantic"}
    heavy |= {"vprbench.methods", "vprbench.datasets"}
    code = "import sys; from vprbench.__main__ import run_command_line as run; "
    code += f"print(run(), [*{heavy} & {{*sys.modules}}])"
    command = [sys.executable, "-c", code, *line.split()]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert (done.stdout.splitlines()[-1], done.stderr) == ("0 []", "")


def test_without_a_command_the_commands_are_named_and_nothing_runs(capsys):
    for arguments in ([], ["--help"], ["help"], ["-h"]):
        text = printed(capsys, *arguments)
        assert [name for name in COMMANDS if f"\nvprbench {name} " not in text] == []
        assert max(map(len, text.splitlines())) <= 120
    assert [*Path().iterdir()] == []
    assert printed(capsys, "--version") == f"vprbench {__version__}\n"


TAKEN = {  # by commands whose options are no fields of a class
    "check": {"method", "dataset", "device", "threads", "seed"},
    "doctor": {"dataset", "output"},
    "completion": set(),
}


@pytest.mark.parametrize("name", COMMANDS)
def test_help_and_completion_name_every_option_that_a_command_takes_with_its_meaning_and_no_other(name, capsys):
    kind = COMMANDS[name].option_class()
    taken = TAKEN[name] if kind is None else {field.name for field in fields(kind)}
    if name in ("compare", "table", "run"):
        taken |= OF_RUNS - {*getattr(kind, "refused", ())}
    lines = helped(capsys, name)
    assert COMMANDS[name].meaning
    assert taken - lines.keys() == set()
    assert {f"{option}=" for option in taken} - {*printed(capsys, "__complete", f"vprbench {name} ").split()} == set()
    assert [option for option in taken - {"seed"} if len(lines[option]) < 3 and option != "methods"] == []


def test_help_has_each_option_with_its_default_and_meaning_of_the_yaml_that_it_builds_on_too(capsys):
    lines = helped(capsys, "table")
    assert lines["rows"] == ["rows", "null", "of conf/paper/table2.yaml; null: all of its rows"]
    assert lines["results"][1:] == ["results", "folder of the stored runs"]  # as a run has it
    lines = helped(capsys, "compare")
    assert [*lines].index("methods") < [*lines].index("metrics")  # its own options come first
    assert lines["timing"][1] == "quick"
    lines = helped(capsys, "method=vprtempo_tuned", "dataset=folders", "timing=quick")
    assert lines["method.max_module"] == ["method.max_module", "1000", "places a module, at most"]
    assert lines["timing.sample"][1] == "64"
    assert lines["dataset.radius_metres"] == ["dataset.radius_metres", "25.0", "for utm"]
    entries = registry.find_entries("method")["vprtempo_tuned"], registry.find_entries("dataset")["folders"]
    wanted = {f"{entry.group}.{name}" for entry in entries for name in entry.options}
    assert wanted - {"method.seed", "method.device"} <= lines.keys()


def test_a_list_is_filtered_by_words_tags_and_weights(capsys):
    for words, there, not_there in (
        ("spiking", {"vprsnn", "vprtempo_tuned"}, {"sad", "synthetic"}),
        ("weights=needed", {"cosplace"}, {"sad"}),
        ("methods gradients", {"hog", "cohog"}, {"sad", "nordland"}),
    ):
        names = {each["name"] for each in json.loads(printed(capsys, "list", *words.split(), "output=json"))}
        assert (there - names, names & not_there) == (set(), set())
        assert {line.split()[0] for line in printed(capsys, "list", *words.split()).splitlines()} >= there


def test_the_last_word_is_completed(capsys):
    for line, wanted in (
        ("tab", ["table"]),
        ("method=sa", ["method=sad", "method=salad", "method=salad_indoor"]),
        *(("-m method=sad,ho", ["method=sad,hog"]), ("table methods=[sad,ho", ["methods=[sad,hog"])),
        ("method=vprtempo method.max_", ["method.max_module="]),
        ("dataset=folders dataset.ref", ["dataset.references="]),
        *(("timing=qu", ["timing=quick"]), ("doctor dataset=sfu", ["dataset=sfu_mountain"])),
        *(("table stored=", ["stored=true", "stored=false"]), ("search tri", ["trials="]), ("completion z", ["zsh"])),
    ):
        assert printed(capsys, "__complete", f"vprbench {line}").split() == wanted


def test_bash_completes_what_stands_behind_an_equals_sign(tmp_path):
    program = tmp_path / "vprbench"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m vprbench "$@"\n')
    program.chmod(0o755)
    line = "vprbench check method=vprtempo_tuned_"
    script = f"""
source <(vprbench completion bash)
COMP_LINE='{line}' COMP_POINT={len(line)} COMP_WORDS=(vprbench check method = vprtempo_tuned_) COMP_CWORD=4
_vprbench vprbench vprtempo_tuned_ =
printf '%s\\n' "${{COMPREPLY[@]}}"
"""
    environment = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}
    done = subprocess.run(["bash", "-c", script], env=environment, capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("vprtempo_tuned_ensemble\n", "")
