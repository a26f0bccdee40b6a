"""What is answered without waiting for Hydra, PyTorch or a plug-in: help, version, lists, and what TAB completes."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path

from vprbench import __version__
from vprbench.errors import BadInput
from vprbench.plugins.entries import Entry, Group, broken_plugins, conf_folders, entries, read
from vprbench.runs.corruption import KINDS, STRENGTHS
from vprbench.terminal.help import (
    HIDDEN,
    SCRIPTS,
    Command,
    Option,
    candidates,
    of_class,
    of_yaml,
    show_commands,
    show_options,
    together,
)
from vprbench.text import near, printable

_TIMING = "vprbench.runs.timing_protocol.Protocol"
_CLUSTER = "vprbench.jobs.options:ClusterOptions"
RUN = Command("vprbench.cli:run_or_sweep", _CLUSTER, groups=("method", "dataset", "timing"), run=None)

#: What may stand in place of a run's options.
COMMANDS: dict[str, Command] = {
    "run": RUN,
    "compare": Command(
        "vprbench.commands.working:compare",
        "vprbench.comparison.checks:Request",
        groups=("dataset", "timing"),
        run=None,
        usual={"timing": "quick"},
    ),
    "list": Command(
        "vprbench.commands.at_once:show_list", "vprbench.plugins.listing:Listing", words="[methods|datasets] [WORD]"
    ),
    "check": Command(
        "vprbench.commands.working:check", groups=("method", "dataset"), run=("device", "threads", "seed")
    ),
    "new": Command("vprbench.commands.working:new", "vprbench.plugins.new:Settings", words="method|dataset NAME"),
    "doctor": Command("vprbench.commands.working:doctor", groups=("dataset",), run=("output",)),
    "status": Command("vprbench.commands.at_once:show_status", "vprbench.runs.run_lock:StatusOptions"),
    "fetch": Command("vprbench.commands.working:fetch", "vprbench.data.fetch.command:Settings", words="[NAME]"),
    "table": Command("vprbench.commands.working:table", "vprbench.paper.gather:TableRequest", ("timing",), None),
    "figures": Command("vprbench.commands.working:figures", "vprbench.paper.gather:TableRequest", ("timing",), None),
    "report": Command("vprbench.commands.working:report", "vprbench.paper.gather:TableRequest", ("timing",), None),
    "search": Command("vprbench.commands.working:search_parameters", "vprbench.tuning.search:Settings"),
    "completion": Command("vprbench.commands.at_once:show_completion", words="bash|zsh|fish"),
}
_NOT_THE_TABLES = (
    "device",
    "output",
    "save",
    "load",
    "wide",
    "stream",
    "corruption",
    "predictions",
)  # options of a run; rows and devices say what it holds


def answered(arguments: Sequence[str]) -> int | None:
    """Answer what can be answered at once and return the exit code; None for all else. Raises BadInput."""
    name, *options = arguments or ["help"]
    if name == HIDDEN:
        print("\n".join(candidates(" ".join(options), COMMANDS, _options, _values)))
    elif name == "--version":
        print(f"vprbench {__version__}")
    elif name in ("--help", "-h", "help") and not options:
        show_commands(__version__, COMMANDS)
    elif name == "help" or {"--help", "-h"} & {*arguments}:
        _help(options if name == "help" else [each for each in arguments if each not in ("--help", "-h")])
    elif name == "list":
        show_list(["wide=true" if option == "--wide" else option for option in options])
    elif name == "status":
        show_status(["wide=true" if option == "--wide" else option for option in options])
    elif name == "completion":
        show_completion(options)
    else:
        return None
    return 0


def _help(arguments: Sequence[str]) -> None:
    name = arguments[0] if arguments and re.fullmatch(r"\w[\w-]*", arguments[0]) else "run"
    if name not in COMMANDS:
        raise BadInput(f"{name} is no command: {near(name, COMMANDS)}")
    show_options(name, COMMANDS[name], _options(COMMANDS[name], arguments))


def show_list(words: Sequence[str]) -> None:
    """Show the methods and datasets, or those that fit: list spiking, list weights=none, list datasets."""
    from vprbench.plugins.listing import Listing, listed
    from vprbench.plugins.options import chosen
    from vprbench.terminal.console import console, show_table

    asked = chosen(Listing, [word for word in words if "=" in word], {})
    found = listed([word for word in words if "=" not in word], asked.weights)
    if asked.output == "json":
        print(json.dumps([asdict(each) for each in found]))
        return
    for group in ("method", "dataset"):
        rows = [
            (each.name, f"BROKEN: {each.broken}" if each.broken else each.description + _origin(each.provider))
            for each in found
            if each.kind == group
        ]
        if rows:
            show_table([f"{group}s", ""], rows, asked.wide or not console().is_terminal)
    for provider, reason in broken_plugins() if not words else ():
        print(printable(f"plug-in {provider} BROKEN: {reason}"))


def show_status(words: Sequence[str]) -> None:
    """Show which runs of a results folder are made now, by whom and how far, and how many are stored."""
    from vprbench.plugins.options import chosen
    from vprbench.runs.run_lock import StatusOptions, row, status
    from vprbench.terminal.console import console, show_table

    asked = chosen(StatusOptions, words, {})
    found = status(asked.results)
    if asked.output == "json":
        print(json.dumps(found))
        return
    print(printable("{results}: {runs} runs and {failures} failures are stored".format(**found)))
    if lines := [row(claim) for claim in found["claims"]]:
        show_table([*lines[0]], [[*line.values()] for line in lines], asked.wide or not console().is_terminal)
    else:
        print("no run is being made")


def _origin(provider: str) -> str:
    return "" if provider == "vprbench" else f"  [{provider}]"


def show_completion(words: Sequence[str]) -> None:
    """Print what makes TAB complete commands, methods, datasets and options: eval "$(vprbench completion bash)"."""
    shell = " ".join(words)
    if shell not in SCRIPTS:
        raise BadInput(f"completion {shell}: {near(shell, SCRIPTS)}, as in vprbench completion bash")
    print(SCRIPTS[shell], end="")


def _options(command: Command, given: Sequence[str]) -> list[Option]:
    """Return the options that a command takes together with those given, those of the chosen method and dataset too."""
    conf = conf_folders()["vprbench"]
    of_run = together(of_yaml(conf / "run.yaml"), of_class("vprbench.runs.request:RunRequest"))
    said = {option.name: option.meaning for option in of_run}
    own = of_class(command.takes) if command.takes else ()
    found = {each.name: replace(each, meaning=each.meaning or said.get(each.name, "")) for each in own}
    for group in command.groups:
        usual = command.usual.get(group, _usual(conf).get(group, ""))
        if not usual:
            continue
        chosen = next((each.partition("=")[2] for each in given if each.startswith(f"{group}=")), usual)
        names = ", ".join(sorted(_values("timing"))) if group == "timing" else f"vprbench list {group}s"
        found[group] = Option(group, "name", usual * (command is RUN or group in command.usual), f"one of {names}")
        entry = _of_entry(group, chosen.split(",")[0], conf)
        found |= {name: replace(each, name=name) for each in entry for name in [f"{group}.{each.name}"]}
    if "cluster" in found:
        chosen = next((each.partition("=")[2] for each in given if each.startswith("cluster=")), "")
        found |= {option.name: option for option in _of_cluster(chosen, conf)}
    for option in of_run:
        if option.name in (command.run or ()) or (command.run is None and _allowed(option, command)):
            found.setdefault(option.name, option)
    return list(found.values())


def _allowed(option: Option, command: Command) -> bool:
    return command is RUN or option.name not in (*_NOT_THE_TABLES, "seed")


def _usual(conf: Path) -> dict[str, str]:
    """Return what a run has of each group of configurations unless another one is chosen."""
    defaults = read((conf / "run.yaml").read_text(encoding="utf-8"))["defaults"]
    return {group: name for each in defaults if isinstance(each, Mapping) for group, name in each.items()}


def _of_entry(group: str, name: str, conf: Path) -> list[Option]:
    """Return the options of a method, a dataset or a timing, and of those that its yaml builds on; none if unknown."""
    known = entries(group) if group in ("method", "dataset") else {}  # type: ignore[arg-type]
    entry = known.get(name) or Entry("method", name, conf / group / f"{name}.yaml", "vprbench")
    if not entry.path.is_file():
        return []
    return together(_of_yamls(entry), of_class(":".join(str(entry.values().get("_target_", _TIMING)).rsplit(".", 1))))


def _of_yamls(entry: Entry) -> list[Option]:
    """Return the options of a yaml, its own first, then those of the yamls that it builds on."""
    below = {option.name: option for base in entry.bases() for option in _of_yamls(base)}
    own = {option.name: option for option in together(of_yaml(entry.path), below.values())}
    return [*own.values(), *(option for name, option in below.items() if name not in own)]


def _of_cluster(name: str, conf: Path) -> list[Option]:
    """Return the options of the jobs of a batch system; none if it is unknown."""
    path = conf / "cluster" / f"{name}.yaml"
    found = together(of_yaml(path), of_class("vprbench.jobs.batch:Job")) if path.is_file() else []
    return [replace(option, name=f"cluster.{option.name}") for option in found]


def _values(name: str) -> Iterator[str]:
    """Yield the names that an option of this name may have as values."""
    conf = conf_folders()["vprbench"]
    group: Group
    for group in ("method", "dataset"):
        if name in (group, f"{group}s"):
            yield from entries(group)
    if name in ("timing", "cluster"):
        yield from (path.stem for path in sorted((conf / name).glob("*.yaml")))
    if name in ("device", "devices"):
        yield from ("cpu", "cuda")
    if name == "corruption":
        yield from (f"{kind}-{strength}" for kind in KINDS for strength in STRENGTHS)
    if name == "corruptions":
        yield from ("all", *KINDS)
    if name in ("rows", "columns"):
        yield from read((conf / "table.yaml").read_text(encoding="utf-8"))[name]
    if name == "[NAME]":
        yield from (path.stem for path in sorted((conf / "fetch").glob("*.yaml")))
    if name == "bash|zsh|fish":
        yield from SCRIPTS
    if name.startswith("[methods"):
        yield from ("methods", "datasets", "spiking")
