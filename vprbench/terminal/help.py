"""Help and completion of a command: what it does, and each of its options with type, default and meaning."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.machinery import PathFinder
from pathlib import Path

from rich.table import Table
from rich.text import Text

from vprbench.terminal.console import console, drawn

_NO_OPTIONS = ("_target_", "defaults", "hydra", "tuned_on", "tags")
_LINE = re.compile(r"( *)(\w+):(?: +(.*?))?(?: +# (.*))?")
_WORDS = {"None": "null", "True": "true", "False": "false"}  # of Python, as the command line has them


@dataclass(frozen=True)
class Option:
    """One option of the command line, in words."""

    name: str
    kind: str = ""  # its type
    default: str = ""
    meaning: str = ""

    def values(self) -> list[str]:
        """Return all values that it may have, if they are few words."""
        return {"bool": ["true", "false"]}.get(self.kind, self.kind.split(" or ") if " or " in self.kind else [])


def of_yaml(path: Path) -> list[Option]:
    """Return the options that a yaml holds, those of a mapping as `mapping.option`."""
    found: list[Option] = []
    above: list[str] = []
    for parts in filter(None, map(_LINE.fullmatch, path.read_text(encoding="utf-8").splitlines())):
        indent, name, default, meaning = (part or "" for part in parts.groups())
        above = [*above[: len(indent) // 2], name]
        if default and above[0] not in _NO_OPTIONS and not default.startswith("${"):
            found.append(Option(".".join(above), _kind_of(default), default, meaning))
    return found


def of_class(named: str) -> list[Option]:
    """Return the fields of a dataclass, `package.module:Name`, its bases' first, or the parameters of a function.

    Empty if its source is not found.
    """
    defined = _defined(*named.split(":"))
    if defined is None:
        return []
    module, text, node = defined
    found: dict[str, Option] = {}
    if isinstance(node, ast.FunctionDef):
        for each in (*node.args.args, *node.args.kwonlyargs):
            found[each.arg] = Option(each.arg, _typed(each.annotation, module))
    elif isinstance(node, ast.ClassDef):
        for base in node.bases:
            found |= {option.name: option for option in of_class(f"{module}:{ast.unparse(base)}")}
        lines = text.splitlines()
        for field in (each for each in node.body if isinstance(each, ast.AnnAssign)):
            name, said = ast.unparse(field.target), re.search("  # (.*)$", lines[(field.end_lineno or 1) - 1])
            meaning = _words(said[1]) if said else ""
            found[name] = Option(name, _typed(field.annotation, module), _default(field.value), meaning)
    return [option for option in found.values() if not option.name.startswith("_")]


def sentence_of(named: str) -> str:
    """Return the first line of the docstring of a function or class, `package.module:name`, without its full stop."""
    defined = _defined(*named.split(":"))
    said = ast.get_docstring(defined[2]) if defined and isinstance(defined[2], ast.FunctionDef | ast.ClassDef) else None
    return (said or "").split("\n")[0].removesuffix(".")


def together(declared: Iterable[Option], others: Iterable[Option]) -> list[Option]:
    """Return the declared options with the types of `others`, and where one has no default or meaning with theirs."""
    known = {option.name: option for option in others}
    found = []
    for option in declared:
        other = known.get(option.name, option)
        meaning, default = option.meaning or other.meaning, option.default or other.default
        found.append(Option(option.name, other.kind or option.kind, default, meaning))
    return found


def _defined(module: str, name: str) -> tuple[str, str, ast.stmt] | None:
    """Return the module, its text and the statement that define a name, followed through imports; None if not found."""
    path = _source_of(module)
    text = path.read_text(encoding="utf-8") if path else ""
    tree = ast.parse(text)
    for node in tree.body:
        if getattr(node, "name", None) == name or (isinstance(node, ast.Assign) and _first(node) == name):
            return module, text, node
    for found in ast.walk(tree):
        if isinstance(found, ast.ImportFrom) and any(name == (each.asname or each.name) for each in found.names):
            above = module.split(".")[: -found.level] if found.level else []
            return _defined(".".join([*above, *filter(None, [found.module])]), name)
    return None


def _source_of(module: str) -> Path | None:
    """Return the file of a module, without importing it or the packages that it is in; None if it is not found."""
    top, *rest = module.split(".")
    if top == "vprbench":
        import vprbench

        places = list(vprbench.__path__)
    else:
        spec = PathFinder.find_spec(top)
        places = list(spec.submodule_search_locations or ()) if spec else []
    files = [Path(place).joinpath(*rest) for place in places]
    found = [path for file in files for path in (file.with_suffix(".py"), file / "__init__.py") if path.is_file()]
    return found[0] if found else None


def _first(node: ast.Assign) -> str:
    return ast.unparse(node.targets[0])


def _typed(annotation: ast.expr | None, module: str) -> str:
    """Return a type hint in words, without the bounds of a value; a name that stands for a Literal is looked up."""
    text = "" if annotation is None else ast.unparse(annotation).removesuffix(" | None")
    if text.isidentifier() and text[0].isupper() and (defined := _defined(module, text)):
        text = ast.unparse(defined[2])
    if bounded := re.fullmatch(r"(?:\w+ = )?Annotated\[(.+?), [A-Z].*\]", text):
        return _typed(ast.parse(bounded[1], mode="eval").body, module)
    if choice := re.search(r"Literal\[(.*?)\]", text):
        return " or ".join(word.strip().strip("'") for word in choice[1].split(","))
    if text.startswith("dict["):
        return "name"  # of a configuration, whose options are options of this one
    return _words(text) if "\n" not in text else "mapping"


def _default(value: ast.expr | None) -> str:
    """Return the default of a field as the command line would be given it; nothing for what is known at run time."""
    if isinstance(value, ast.Call):
        factory = [keyword.value for keyword in value.keywords if keyword.arg in ("default", "default_factory")]
        value = next(iter([*factory, *value.args]), None)
        if isinstance(value, ast.Name) and value.id in ("list", "dict"):
            return "[]" if value.id == "list" else "{}"
    try:
        plain = ast.literal_eval(value) if value is not None else ""
    except ValueError:
        return ""
    return _words(str(plain)).replace("'", "").replace(", ", ",")


def _kind_of(default: str) -> str:
    """Return the type of what a yaml holds."""
    for kind, pattern in {
        "": r"|null",
        "bool": r"true|false",
        "int": r"-?\d+",
        "float": r"-?\d[\d.]*(e-?\d+)?",
        "list": r"\[.*\]",
    }.items():
        if re.fullmatch(pattern, default):
            return kind
    return "str"


def _words(text: str) -> str:
    return re.sub(r"\b(None|True|False)\b", lambda found: _WORDS[found[0]], text)


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


HIDDEN = "__complete"  # the command that a script asks: the line so far -> what its last word may become

_BASH = f"""\
_vprbench() {{
    local IFS=$'\\n' line="${{COMP_LINE:0:COMP_POINT}}" word
    word="${{line##*[[:space:]]}}"
    COMPREPLY=($("$1" {HIDDEN} "$line" 2>/dev/null))
    [[ ${{#COMPREPLY[@]}} == 1 && ${{COMPREPLY[0]}} == *= ]] && compopt -o nospace
    COMPREPLY=("${{COMPREPLY[@]#"${{word%"${{word##*[=:]}}"}}"}}")  # for bash a word begins after = and :
}}
complete -o default -F _vprbench vprbench
"""
_ZSH = f"""\
#compdef vprbench
_vprbench() {{
    local -a found
    found=(${{(f)"$($words[1] {HIDDEN} "${{(j: :)words[1,CURRENT-1]}} $PREFIX" 2>/dev/null)"}})
    compadd -Q -S '' -- ${{(M)found:#*=}}
    compadd -Q -- ${{found:#*=}}
    (( $#found )) || {{ compset -P '*='; _files }}
}}
compdef _vprbench vprbench
"""
_FISH = f"""\
complete -c vprbench -f -a '(vprbench {HIDDEN} (commandline -cp | string collect) 2>/dev/null)'
"""
SCRIPTS = {"bash": _BASH, "zsh": _ZSH, "fish": _FISH}


def candidates(
    line: str,
    commands: Mapping[str, Command],
    options_of: Callable[[Command, Sequence[str]], Iterable[Option]],
    values_of: Callable[[str], Iterable[str]],
) -> list[str]:
    """Return what the last word of a line may become; `values_of` knows the values of an option or of a usage's words.

    What takes several values is completed value by value, after commas.
    """
    *given, word = line.lstrip().split(" ")[1:] or [""]
    given = [each for each in given if each]
    command = commands.get(given[0] if given else "run", commands["run"])
    name, equals, value = word.partition("=")
    options = options_of(command, given)
    if equals:
        head = value[: max(value.rfind(","), value.rfind("[")) + 1]
        known = next((option for option in options if option.name == name), Option(name))
        among, taken = [*values_of(name)] or known.values(), head.strip("[").split(",")
        found = [f"{name}={head}{each}" for each in among if each not in taken]
    else:
        taken = [each.partition("=")[0] for each in given]
        found = [f"{option.name}=" for option in options if option.name not in taken]
        found = [*values_of(command.words), *found] if given else [*commands, *found]
        if not (given or word):  # of a run, what comes first
            found = [*commands, *(f"{group}=" for group in command.groups)]
    return [each for each in found if each.startswith(word)]
