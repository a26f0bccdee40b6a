"""Help and completion of a command: its options, from the yaml files in conf/ and from the fields of its class."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import MISSING, dataclass, fields, replace
from pathlib import Path
from typing import cast, get_args

from rich.table import Table
from rich.text import Text

from vprbench import __version__
from vprbench.commands.catalogue import ALL, COMMANDS
from vprbench.plugins.entries import Entry, Folder, find_conf_folders, find_default, find_entries
from vprbench.plugins.options import MEANING
from vprbench.terminal.console import format_lines, make_console

_NO_OPTIONS = ("_target_", "defaults", "hydra", "tuned_on", "tags")
_LINE = re.compile(r"( *)(\w+):(?: +(.*?))?(?: +# (.*))?")  # of a yaml: name, default and meaning


@dataclass(frozen=True)
class Option:
    """One option of the command line, in words."""

    name: str
    default: str = ""
    meaning: str = ""


def list_options(name: str, given: Sequence[str]) -> list[Option]:
    """Return the options of a command; `given` ones choose the method, dataset, timing and cluster among them."""
    command, kind = COMMANDS[name], COMMANDS[name].option_class()
    of_run = {option.name: option for option in _read_options(find_conf_folders()["vprbench"] / "run.yaml")}
    found = {option.name: option for option in (_describe_fields(kind) if kind else ())}
    chosen = {"timing": "quick"} if name == "compare" else {}
    chosen |= dict(option.split("=", 1) for option in given if "=" in option)
    for group in (each for each in get_args(Folder) if each in (*command.takes, *found)):
        usual = chosen.get(group) or ("" if group == "cluster" else find_default(group))
        words = f"one of {', '.join(find_entries(group))}" if group == "timing" else f"one of vprbench list {group}s"
        found.setdefault(group, Option(group, usual if name == "run" or group in chosen else "", words))
        found |= _describe_entry(find_entries(group).get(usual.split(",")[0]))
    others = [option for option in of_run if option not in getattr(kind, "refused", ())]
    for option in others if ALL in command.takes else command.takes:
        found.setdefault(option, of_run.get(option, Option(option)))
    return [replace(one, meaning=one.meaning or of_run.get(one.name, one).meaning) for one in found.values()]


def _describe_entry(entry: Entry | None) -> dict[str, Option]:
    """Return the options in an entry's yaml, and in those that it builds on, by their names `group.option`."""
    if entry is None or entry.path.suffix != ".yaml":
        return {}
    found = {name: option for base in entry.bases() for name, option in _describe_entry(base).items()}
    for option in _read_options(entry.path):
        name = f"{entry.group}.{option.name}"
        found[name] = replace(option, name=name, meaning=option.meaning or found.get(name, option).meaning)
    return found


def _read_options(path: Path) -> Iterator[Option]:
    """Yield the lines of a yaml as options, those of a mapping as `mapping.option`, with their comments."""
    above: list[str] = []
    for parts in filter(None, map(_LINE.fullmatch, path.read_text(encoding="utf-8").splitlines())):
        indent, name, default, meaning = (part or "" for part in parts.groups())
        above = [*above[: len(indent) // 2], name]
        if default and above[0] not in _NO_OPTIONS and not default.startswith("${"):
            yield Option(".".join(above), default, meaning)


def _describe_fields(kind: type) -> Iterator[Option]:
    """Yield the fields of a dataclass as options, its own before those of the classes that it builds on."""
    for one in sorted(fields(kind), key=lambda one: one.name not in kind.__annotations__):
        value = one.default if one.default_factory is MISSING else one.default_factory()
        default = "" if value is MISSING else json.dumps(value, separators=(",", ":")).replace('"', "")
        yield Option(one.name, default, one.metadata.get(MEANING, ""))


_INTRODUCTION = """\
which method of Visual Place Recognition is better, how fast it is, and how sure that is

vprbench method=NAME dataset=NAME [option=value ...]   run one method on one dataset
vprbench -m method=NAME,NAME dataset=NAME,NAME ...     run all combinations, each in its own process"""

_MORE = """
vprbench COMMAND --help shows the options of a command, vprbench method=NAME dataset=NAME --help those of a run.
python -m vprbench is the same program."""


def print_commands() -> None:
    """Print the ways to run a method, and the commands."""
    table = _make_table(2)
    for name, command in COMMANDS.items():
        table.add_row(Text(f"vprbench {name} {command.words}".rstrip(), style="bold"), Text(command.meaning))
    print(f"vprbench {__version__} - {_INTRODUCTION}\n\n{format_lines(table, make_console())}\n{_MORE}")


def print_options(name: str, given: Sequence[str]) -> None:
    """Print the meaning of a command and its options."""
    command, page, table = COMMANDS[name], make_console(), _make_table(3)
    table.columns[1].max_width, table.columns[1].overflow = page.width // 5, "fold"
    for option in list_options(name, given):
        table.add_row(Text(option.name, style="bold"), Text(option.default, style="dim"), Text(option.meaning))
    usage = " ".join(filter(None, ["vprbench", name, command.words, "[option=value ...]" * bool(table.rows)]))
    print(f"{usage}\n{command.meaning}\n\n{format_lines(table, page)}".rstrip())


def _make_table(n_columns: int) -> Table:
    """Return an empty table whose first column stays whole."""
    table = Table.grid(*[""] * n_columns, padding=(0, 2, 0, 0))
    table.columns[0].no_wrap = True
    return table


def complete(line: str) -> list[str]:
    """Return the words that the last word of a command line may become: commands, options, and values of options.

    An option that takes several values is completed value by value, after commas.
    """
    *given, word = line.split(" ")[1:] or [""]
    name = given[0] if given and given[0] in COMMANDS else "run"
    options = {option.name: option for option in list_options(name, given)}
    option, equals, value = word.partition("=")
    group = option.removesuffix("s") if name != "run" else option
    if equals and option in options:
        head = value[: max(value.rfind(","), value.rfind("[")) + 1]
        values = find_entries(cast(Folder, group)) if group in get_args(Folder) else ("true", "false")
        is_known = group in get_args(Folder) or options[option].default in values
        found = [f"{option}={head}{each}" for each in values if is_known and each not in head.strip("[").split(",")]
    else:
        found = [f"{each}=" for each in options if f"{each}=" not in {one[: len(each) + 1] for one in given}]
        found += re.findall("[a-z]+", COMMANDS[name].words) if given else COMMANDS
    return [each for each in found if each.startswith(word)]
