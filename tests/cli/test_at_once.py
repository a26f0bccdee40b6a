"""Help, version, lists and completion: answered without Hydra, PyTorch or a plug-in, in the first process."""

import importlib
import json
import os
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest
from checkout import ROOT

from vprbench import __version__, cli
from vprbench.commands.at_once import COMMANDS, answered
from vprbench.paper.gather import TableRequest
from vprbench.plugins import registry
from vprbench.runs.request import OPTIONS

HEAVY = ("hydra", "omegaconf", "torch", "numpy", "vprbench.methods", "vprbench.datasets")


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("COLUMNS", raising=False)


def printed(capsys, *arguments):
    assert answered(arguments) == 0
    return capsys.readouterr().out


def test_it_is_answered_by_the_first_process_and_nothing_heavy_is_imported():
    code = f"""
import subprocess, sys
subprocess.Popen = None
from vprbench.__main__ import main
for line in "", "--version", "list spiking", "table --help", "__complete method=sad,h":
    sys.argv[1:] = line.split()
    assert main() == 0
sys.exit([name for name in {HEAVY} if name in sys.modules] or 0)
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_without_a_command_the_commands_are_named_and_nothing_runs_and_the_help_of_each_fits_100_columns(capsys):
    for arguments in ([], ["--help"], ["help"], ["-h"]):
        assert cli.main(arguments) == 0
        text = capsys.readouterr().out
        assert [name for name in COMMANDS if f"\nvprbench {name} " not in text] == []
        assert max(map(len, text.splitlines())) <= 120
    assert [*Path().iterdir()] == []
    assert printed(capsys, "--version") == f"vprbench {__version__}\n"
    for name, command in COMMANDS.items():
        room, _, function = command.does.partition(":")
        assert callable(getattr(importlib.import_module(room), function))
        assert command.meaning
        assert max(map(len, printed(capsys, name, "--help").splitlines()[2:]), default=0) <= 100


def helped(capsys, *arguments):
    """The lines of a help by their options: option, type, default and meaning."""
    lines = printed(capsys, *arguments, "--help").splitlines()
    return {line.split()[0]: line.split(maxsplit=3) for line in lines if line.strip()}


def test_help_has_each_option_with_type_default_and_meaning(capsys):
    lines = helped(capsys, "table")
    assert {field.name for field in fields(TableRequest)} <= lines.keys()
    assert lines["rows"] == ["rows", "list[str]", "null", "of conf/table.yaml; null: those of the paper"]
    assert lines["results"][1:] == ["str", "results", "folder of the stored runs"]  # as a run has it
    lines = helped(capsys, "method=vprtempo_tuned", "dataset=folders", "timing=quick")
    assert {*OPTIONS} <= lines.keys()
    of_base = ["method.max_module", "int", "1000", "places a module, at most"]  # meant by the yaml that it builds on
    assert lines["method.max_module"] == of_base
    assert lines["timing.sample"][2] == "64"
    assert lines["dataset.radius_metres"] == ["dataset.radius_metres", "float", "25.0", "for utm"]
    asked = {"method": "vprtempo_tuned", "dataset": "folders"}
    entries = {group: registry.entries(group)[name] for group, name in asked.items()}
    wanted = {f"{group}.{name}" for group, entry in entries.items() for name in entry.options}
    assert wanted - {"method.seed", "method.device"} <= lines.keys()


@pytest.mark.parametrize("name", [name for name, command in COMMANDS.items() if command.takes])
def test_help_and_completion_name_every_option_that_a_command_takes(name, capsys):
    room, _, kind = COMMANDS[name].takes.partition(":")
    taken = {field.name for field in fields(getattr(importlib.import_module(room), kind))}
    assert taken - helped(capsys, name).keys() == set()
    assert {f"{option}=" for option in taken} - {*printed(capsys, "__complete", f"vprbench {name} ").split()} == set()


@pytest.mark.parametrize(
    ("words", "there", "not_there"),
    [
        ("spiking", {"vprsnn", "vprtempo_tuned"}, {"sad", "synthetic"}),
        ("weights=none", {"sad", "vprtempo"}, {"cosplace", "synthetic"}),
        ("weights=needed", {"cosplace"}, {"sad"}),
        ("datasets", {"synthetic", "folders"}, {"sad"}),
        ("methods gradients", {"hog", "cohog"}, {"sad", "street"}),
    ],
)
def test_a_list_is_filtered_by_words_tags_and_weights(words, there, not_there, capsys):
    names = {each["name"] for each in json.loads(printed(capsys, "list", *words.split(), "output=json"))}
    assert (there - names, names & not_there) == (set(), set())
    assert {line.split()[0] for line in printed(capsys, "list", *words.split()).splitlines()} >= there


@pytest.mark.parametrize(
    ("line", "wanted"),
    [
        ("tab", ["table"]),
        ("method=sa", ["method=sad", "method=salad", "method=salad_indoor"]),
        ("method=sad corruption=bl", ["corruption=blur-1", "corruption=blur-2", "corruption=blur-3"]),
        ("method=vprtempo method.query_rule=", ["method.query_rule=spiking", "method.query_rule=linear"]),
        *(("-m method=sad,ho", ["method=sad,hog"]), ("table methods=[sad,ho", ["methods=[sad,hog"])),
        ("method=vprtempo method.max_", ["method.max_module="]),
        ("dataset=folders dataset.ref", ["dataset.references="]),
        *(("timing=qu", ["timing=quick"]), ("doctor dataset=sfu", ["dataset=sfu_mountain"])),
        *(("fetch nordland_6", ["nordland_64x32"]), ("table stored=", ["stored=true", "stored=false"])),
        *(("search tri", ["trials="]), ("list sp", ["spiking"]), ("completion z", ["zsh"])),
        ("compare corruptions=a", ["corruptions=all"]),
    ],
)
def test_the_last_word_is_completed(line, wanted, capsys):
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
    told = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}
    done = subprocess.run(["bash", "-c", script], env=told, capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("vprtempo_tuned_ensemble\n", "")
