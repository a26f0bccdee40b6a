"""What a person is told of a command: what it does, and each of its options with type, default and meaning."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from rich.table import Table
from rich.text import Text

from vprbench.terminal.console import console, drawn
from vprbench.terminal.described import Option, sentence_of

_INTRODUCTION = """\
which method of Visual Place Recognition is better, how fast it is, and how sure that is

vprbench method=NAME dataset=NAME [option=value ...]   run one method on one dataset
vprbench -m method=NAME,NAME dataset=NAME,NAME ...     run all combinations, each in its own process"""

_MORE = """
vprbench COMMAND --help shows the options of a command, vprbench method=NAME dataset=NAME --help those of a run.
python -m vprbench is the same program."""


@dataclass(frozen=True)
class Command:
    """One command: what does it, and where its options are declared."""

    does: str  # module:function, whose docstring says in its first sentence what that is
    takes: str = ""  # the class whose fields are its options, module:Class
    groups: tuple[str, ...] = ()  # that it takes a choice of, with the options of what is chosen: method, dataset
    run: tuple[str, ...] | None = ()  # options of a run that it takes too; None: all that it has not itself
    words: str = ""  # what it takes before options: NAME
    usual: Mapping[str, str] = field(default_factory=dict)  # by group, its own choice where none is given

    @property
    def meaning(self) -> str:
        """What it does, in a sentence."""
        return sentence_of(self.does)


def show_commands(version: str, commands: Mapping[str, Command]) -> None:
    """Print what there is: the ways to run something, and the commands."""
    page, table = console(), _table("", "")
    for name, command in commands.items():
        table.add_row(Text(f"vprbench {name} {command.words}".rstrip(), style="bold"), Text(command.meaning))
    print(f"vprbench {version} - {_INTRODUCTION}\n\n{drawn(table, page)}\n{_MORE}")


def show_options(name: str, command: Command, options: Sequence[Option]) -> None:
    """Print what a command does and takes."""
    page, table = console(), _table("option", "type", "default", "meaning")
    for column in table.columns[1:3]:
        column.max_width, column.overflow = page.width // 5, "fold"
    for option in options:
        kind, default = (Text(text, style="dim") for text in (option.kind, option.default))
        table.add_row(Text(option.name, style="bold"), kind, default, Text(option.meaning))
    usage = " ".join(filter(None, ["vprbench", name, command.words, "[option=value ...]" * bool(options)]))
    print(f"{usage}\n{command.meaning}", *(["", drawn(table, page)] if options else []), sep="\n")


def _table(*heads: str) -> Table:
    """Return an empty table whose first column stays whole."""
    table = Table(*heads, box=None, pad_edge=False, padding=(0, 2, 0, 0), show_header=any(heads))
    table.columns[0].no_wrap = True
    return table
