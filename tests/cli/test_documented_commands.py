"""Every command that README and docs show is understood, and its document says how to get its frames."""

import os
import re
import shlex
import subprocess
from pathlib import Path

import pytest
from checkout import ROOT
from omegaconf import OmegaConf

from vprbench import cli
from vprbench.compare.checks import checked
from vprbench.datasets.synthetic import synthetic
from vprbench.paper import gather
from vprbench.plugins import registry
from vprbench.run.settings import checked_settings

GUIDES = (f"docs/{path.name}" for path in sorted((ROOT / "docs").glob("*.md")))
DOCUMENTS = ("README.md", "CONTRIBUTING.md", "results/README.md", *GUIDES)
JOURNEY = synthetic(places=12)


def shown(document):
    """Yield the commands of a document, but for names in capitals that a reader fills in and the method it defines."""
    text = (ROOT / document).read_text(encoding="utf-8").replace("\\\n", " ")
    for block in re.findall(r"^```\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
        yield from re.findall(r"^(?:python -m vprbench|vprbench|make) .*", block, re.MULTILINE)
    yield from re.findall(r"`((?:python -m )?vprbench [^`]*)`", text)


def commands(document):
    """Return the commands of a document in its order, each once; not those that install, test or measure speed."""
    left_out = r"[= ]NAME|COMMAND|darkness|lamps|mine|^make (test|docs|install|check|bench|gpu|chaos)|vprbench bench"
    told = (" ".join(shlex.split(command, comments=True)) for command in shown(document))
    return [command for command in dict.fromkeys(told) if not re.search(left_out, command)]


COMMANDS = sorted({command for document in DOCUMENTS for command in commands(document)})


def of_make(command):
    """Return the options with which a target of the Makefile calls the program."""
    given = {name: value for name, value in os.environ.items() if name not in ("MAKEFLAGS", "MAKEOVERRIDES", "ARGS")}
    asked = ["make", "-n", *command.split()[1:]]
    told = subprocess.run(asked, cwd=ROOT, env=given, capture_output=True, text=True, check=True)
    return shlex.split(told.stdout.replace("\\\n", " ").rsplit("-m vprbench ", 1)[1].splitlines()[0])


def options_of(command, folder):
    """Return the options that a documented command gives the program; its folders under /data lie in `folder`."""
    for name in re.findall(r"/data/(\w+)", command):
        (folder / name).mkdir(exist_ok=True)
    command = command.replace("/data/", f"{folder}/")
    options = of_make(command) if command.startswith("make") else command.removeprefix("python -m ").split()[1:]
    return [option for option in options if not re.match(r"workers=|cluster[.=]", option)]  # one process here


@pytest.fixture
def understood(tmp_path, monkeypatch):
    """What stands in for the work of each command checks its options; the names of those that came so far."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(registry, "make_dataset", lambda config: JOURNEY)  # whatever is there of the documents' frames
    done = []

    def instead(target, check):
        name = target.rpartition(".")[2]
        monkeypatch.setattr(target, lambda *given, **_: int(check(*given) is None or done.append(name) is not None))

    def check_run(config):
        plain = OmegaConf.to_container(config, resolve=True)
        checked_settings(plain)
        return registry.make_method(plain["method"])

    instead("vprbench.cli._run", check_run)
    instead("vprbench.cli.swept", lambda runs, _: runs)
    instead("vprbench.compare.make.make_comparison", lambda asked, compose: checked(asked, compose)[0])
    for name in ("table.make.make_table", "figures.make.make_figures", "page.make.make_report"):
        instead(f"vprbench.paper.{name}", lambda asked, _, compose: gather.choose(asked, compose))
    instead("vprbench.data.doctor.command", lambda _, build, *__: build())
    monkeypatch.setattr("vprbench.tuning.search.search", lambda settings, *_: done.append("search"))
    monkeypatch.setattr("vprbench.tuning.text.write", lambda *_: "")
    return done


@pytest.mark.parametrize("command", COMMANDS)
def test_a_documented_command_is_understood(command, understood, tmp_path):
    options = options_of(command, tmp_path)
    (tmp_path / "results").mkdir()
    if answered_at_once(options) is None:
        foreign = "stores=[/mnt/gpu-box/results]" in options  # a folder that is not here
        assert cli.main(options) == (2 if foreign else 0)
        assert len(understood) == (not foreign)


@pytest.mark.parametrize("document", DOCUMENTS)
def test_a_document_says_how_to_get_the_frames_that_its_commands_need(document):
    asked = {option for command in commands(document) if "dataset.root" not in command for option in command.split()}
    needed = {option.removeprefix("dataset=") for option in asked if option.startswith("dataset=")}
    offered = {path.stem for path in (ROOT / "conf" / "fetch").glob("*.yaml")}
    named = set(re.findall(r"vprbench fetch (\w+)", (ROOT / document).read_text(encoding="utf-8")))
    assert needed & offered <= named


def answered_at_once(options):
    """Give a command that runs nothing to the command line; return None for another one."""
    if options[0] in ("list", "status", "--cfg", "--version", "completion") or "--help" in options:
        assert cli.main(options) == 0
    elif options[0] == "fetch":
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("VPRBENCH_DATA", str(Path("downloads").absolute()))
            assert cli.main(options) == (2 if len(options) > 1 else 0)  # the tests have no net
    else:
        return None
    return 0
