"""Help and completion of a command: its options, from the yaml files in conf/ and from the fields of its class."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import MISSING, Field, dataclass, fields, replace
from pathlib import Path
from typing import Any

from rich.table import Table
from rich.text import Text

from vprbench import __version__
from vprbench.commands.catalogue import COMMANDS
from vprbench.plugins.entries import Entry, conf_folders, entries, find_default
from vprbench.plugins.options import MEANING
from vprbench.terminal.console import console, format_table

_NO_OPTIONS = ("_target_", "defaults", "hydra", "tuned_on", "tags")
_LINE = re.compile(r"( *)(\w+):(?: +(.*?))?(?: +# (.*))?")  # of a yaml: name, default and meaning


@dataclass(frozen=True)
class Option:
    """One option of the command line, in words."""

    name: str
    default: str = ""
    meaning: str = ""
    values: tuple[str, ...] = ()  # by which TAB completes it


def list_options(name: str, given: Sequence[str]) -> list[Option]:
    """Return the options of a command; `given` ones choose the method, dataset, timing and cluster among them."""
    command = COMMANDS[name]
    choices = dict(option.split("=", 1) for option in given if "=" in option)
    of_run = {option.name: option for option in _read_options(conf_folders()["vprbench"] / "run.yaml")}
    kind = command.option_class()
    found = {one.name: one for one in (map(_describe_field, _sort_fields(kind)) if kind else ())}
    for group in command.groups:
        known, usual = entries(group), command.usual.get(group) or find_default(group)
        shown = usual if name == "run" or group in command.usual else ""
        meaning = f"one of {', '.join(known)}" if group == "timing" else f"one of vprbench list {group}s"
        found[group] = Option(group, shown, meaning, tuple(known))
        found |= _describe_entry(known.get(choices.get(group, usual).split(",")[0]))
    if "cluster" in found:
        known = entries("cluster")
        found["cluster"] = replace(found["cluster"], values=tuple(known))
        found |= _describe_entry(known.get(choices.get("cluster", "")))
    if "methods" in found:
        found["methods"] = replace(found["methods"], values=tuple(entries("method")))
    refused = getattr(kind, "refused", ())
    taken = [one for one in of_run if one not in refused] if command.run is None else command.run
    found |= {one: of_run[one] for one in taken if one not in found}
    return [replace(one, meaning=one.meaning or of_run.get(one.name, one).meaning) for one in found.values()]


def _describe_entry(entry: Entry | None) -> dict[str, Option]:
    """Return the options in an entry's yaml, and in those that it builds on, by their names `group.option`."""
    if entry is None or entry.path.suffix != ".yaml":
        return {}
    below = {name: option for base in entry.bases() for name, option in _describe_entry(base).items()}
    own = [replace(option, name=f"{entry.group}.{option.name}") for option in _read_options(entry.path)]
    return below | {one.name: replace(one, meaning=one.meaning or below.get(one.name, one).meaning) for one in own}


def _read_options(path: Path) -> Iterator[Option]:
    """Yield the lines of a yaml as options, those of a mapping as `mapping.option`, with their comments."""
    above: list[str] = []
    for parts in filter(None, map(_LINE.fullmatch, path.read_text(encoding="utf-8").splitlines())):
        indent, name, default, meaning = (part or "" for part in parts.groups())
        above = [*above[: len(indent) // 2], name]
        if default and above[0] not in _NO_OPTIONS and not default.startswith("${"):
            yield Option(".".join(above), default, meaning, _list_values(default))


def _sort_fields(kind: type) -> list[Field[Any]]:
    """Return the fields of a dataclass, its own before those of the classes that it builds on."""
    return sorted(fields(kind), key=lambda one: one.name not in kind.__annotations__)


def _describe_field(one: Field[Any]) -> Option:
    """Return a field of a dataclass as an option."""
    value = one.default if one.default_factory is MISSING else one.default_factory()
    default = "" if value is MISSING else _format_default(value)
    return Option(one.name, default, one.metadata.get(MEANING, ""), _list_values(default))


def _list_values(default: str) -> tuple[str, ...]:
    return ("true", "false") if default in ("true", "false") else ()


def _format_default(value: Any) -> str:
    """Return a value as the command line is given it."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    return f"[{','.join(map(_format_default, value))}]" if isinstance(value, list) else str(value)


_INTRODUCTION = """\
which method of Visual Place Recognition is better, how fast it is, and how sure that is

vprbench method=NAME dataset=NAME [option=value ...]   run one method on one dataset
vprbench -m method=NAME,NAME dataset=NAME,NAME ...     run all combinations, each in its own process"""

_MORE = """
vprbench COMMAND --help shows the options of a command, vprbench method=NAME dataset=NAME --help those of a run.
python -m vprbench is the same program."""


def print_commands() -> None:
    """Print the ways to run a method, and the commands."""
    table = _make_table("", "")
    for name, command in COMMANDS.items():
        table.add_row(Text(f"vprbench {name} {command.words}".rstrip(), style="bold"), Text(command.meaning))
    print(f"vprbench {__version__} - {_INTRODUCTION}\n\n{format_table(table, console())}\n{_MORE}")


def print_options(name: str, given: Sequence[str]) -> None:
    """Print the meaning of a command and its options."""
    command, options = COMMANDS[name], list_options(name, given)
    page, table = console(), _make_table("option", "default", "meaning")
    table.columns[1].max_width, table.columns[1].overflow = page.width // 5, "fold"
    for option in options:
        table.add_row(Text(option.name, style="bold"), Text(option.default, style="dim"), Text(option.meaning))
    usage = " ".join(filter(None, ["vprbench", name, command.words, "[option=value ...]" * bool(options)]))
    print(f"{usage}\n{command.meaning}", *(["", format_table(table, page)] if options else []), sep="\n")


def _make_table(*heads: str) -> Table:
    """Return an empty table whose first column stays whole."""
    table = Table(*heads, box=None, pad_edge=False, padding=(0, 2, 0, 0), show_header=any(heads))
    table.columns[0].no_wrap = True
    return table


def complete(line: str) -> list[str]:
    """Return the words that the last word of a command line may become: commands, options, and values of options.

    An option that takes several values is completed value by value, after commas.
    """
    *given, word = line.lstrip().split(" ")[1:] or [""]
    given = [each for each in given if each]
    name = given[0] if given and given[0] in COMMANDS else "run"
    options = list_options(name, given)
    option, equals, value = word.partition("=")
    if equals:
        head = value[: max(value.rfind(","), value.rfind("[")) + 1]
        values = next((one.values for one in options if one.name == option), ())
        found = [f"{option}={head}{each}" for each in values if each not in head.strip("[").split(",")]
    elif given:
        taken = [each.partition("=")[0] for each in given]
        words = re.findall("[a-z]+", COMMANDS[name].words)
        found = [*words, *(f"{one.name}=" for one in options if one.name not in taken)]
    else:
        found = [*COMMANDS, *(f"{one.name}=" for one in options if word or one.name in COMMANDS[name].groups)]
    return [each for each in found if each.startswith(word)]
