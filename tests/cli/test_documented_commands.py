"""Every command that README and docs show is understood, and every file that they name is there."""

import os
import re
import shlex
import subprocess
from fnmatch import fnmatchcase

import pytest
from checkout import ROOT

from vprbench.commands.catalogue import COMMANDS
from vprbench.commands.help import list_options
from vprbench.config import make_request, split_sweep
from vprbench.jobs.options import ClusterOptions
from vprbench.plugins.entries import find_entries

DOCUMENTS = (
    "README.md",
    "CONTRIBUTING.md",
    "results/README.md",
    *(f"docs/{path.name}" for path in sorted((ROOT / "docs").glob("*.md"))),
)


def commands(document):
    """Return the commands of a document in its order, each once; not those that install, test or measure speed.

    Names in capitals are for the reader to fill in, and some methods are for the reader to write.
    """
    left_out = r"[= ]NAME|COMMAND|darkness|lamps|mine|^make (test|docs|install|check|bench|gpu|chaos)|vprbench bench"
    text = (ROOT / document).read_text(encoding="utf-8").replace("\\\n", " ")
    blocks = re.findall(r"^```\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    found = re.findall(r"^(?:python -m vprbench|vprbench|make) .*", "\n".join(blocks), re.MULTILINE)
    found += re.findall(r"`((?:python -m )?vprbench [^`]*)`", text)
    plain = (" ".join(shlex.split(command, comments=True)) for command in found)
    return [command for command in dict.fromkeys(plain) if not re.search(left_out, command)]


def options_of(command):
    """Return the words that a documented command, or its target of the Makefile, gives the program."""
    if command.startswith("make"):
        given = {
            name: value for name, value in os.environ.items() if name not in ("MAKEFLAGS", "MAKEOVERRIDES", "ARGS")
        }
        make = ["make", "-n", *command.split()[1:]]
        done = subprocess.run(make, cwd=ROOT, env=given, capture_output=True, text=True, check=True)
        command = done.stdout.replace("\\\n", " ").rsplit("-m vprbench ", 1)[1].splitlines()[0]
    return shlex.split(re.sub(r"^(python -m )?vprbench ", "", command))


@pytest.mark.parametrize("document", [document for document in DOCUMENTS if commands(document)])
def test_a_document_gives_commands_options_that_they_have_and_values_that_fit(document):
    for command in commands(document):
        words = options_of(command)
        name, given = (words[0], words[1:]) if words[0] in COMMANDS else ("run", words)
        named = {re.split("[.=]", word.lstrip("+"))[0] for word in given if "=" in word}
        known = {option.name.split(".")[0] for option in list_options(name, given)}
        known |= {*find_entries("method")} if name == "compare" else set()  # whose arguments follow their names
        assert named <= known, command
        if name == "run" and "--help" not in given:
            for options in split_sweep([word for word in given if "=" in word and not ClusterOptions.has(word)]):
                make_request(options)


@pytest.mark.parametrize("document", DOCUMENTS)
def test_a_document_says_how_to_get_the_frames_that_its_commands_need(document):
    asked = {option for command in commands(document) if "dataset.root" not in command for option in command.split()}
    needed = {option.removeprefix("dataset=") for option in asked if option.startswith("dataset=")}
    offered = {path.stem for path in (ROOT / "conf" / "fetch").glob("*.yaml")}
    named = set(re.findall(r"vprbench fetch (\w+)", (ROOT / document).read_text(encoding="utf-8")))
    assert needed & offered <= named


TREE = [
    f"/{path.relative_to(ROOT)}"
    for top in ("vprbench", "methods", "datasets", "conf", "docs", "tests", ".ci")
    for path in (ROOT / top).rglob("*")
]
TO_BE_WRITTEN = re.compile(r"NAME|darkness|lamps|mine|^table/\*|^results/")  # by a reader, a plug-in or a command


@pytest.mark.parametrize("document", DOCUMENTS)
def test_every_file_that_a_document_names_is_there(document):
    text = (ROOT / document).read_text(encoding="utf-8")
    named = re.findall(r"`([\w./*-]+\.(?:py|pyi|j2|md|css|js)|[\w./*-]+/[\w.*-]+\.(?:yaml|csv))`", text)
    wanted = {name.removeprefix("./") for name in named if not TO_BE_WRITTEN.search(name)}
    assert [name for name in wanted if not any(fnmatchcase(path, f"*/{name}") for path in TREE)] == []
