"""A method or dataset in a loose file, ./mine.py:MyMethod: loaded from its path, its parameters its options."""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.util
import inspect
import re
import sys
import traceback
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

from vprbench.errors import BadInput
from vprbench.plugins.entries import Entry, Group
from vprbench.text import near

_OURS = str(Path(__file__).parents[1])
_BETWEEN = ("importlib", "hydra", "<frozen")  # between us and the plug-in


def describe_error(error: BaseException, file: str | None = None) -> str:
    """Return an error in one line, with the place that raised it: the innermost in `file`, else in any plug-in."""
    if isinstance(error, SyntaxError):
        return f"SyntaxError: {error.msg}{_place(error.filename, error.lineno)}"
    text = (str(error).splitlines() or [""])[0]
    if not isinstance(error, ImportError) or not text:
        text = ": ".join(filter(None, [type(error).__name__, text]))
    frames = traceback.extract_tb(error.__traceback__)
    there = [frame for frame in frames if (frame.filename == file if file else _of_a_plug_in(frame.filename))]
    return text + (_place(there[-1].filename, there[-1].lineno) if there else "")


def _of_a_plug_in(file: str) -> bool:
    return not file.startswith(_OURS) and not any(part in file for part in _BETWEEN)


def _place(file: str | None, line: int | None) -> str:
    if file is None:
        return ""
    path = Path(file)
    return f" ({path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path}, line {line})"


_NAMED = re.compile(r"(?P<file>[^][,()'\"]+\.py)(?::(?P<name>\w+))?")
_OF_THE_RUN = ("seed", "device")  # parameters of a method that take the values of the run


@dataclass(frozen=True)
class LooseEntry(Entry):
    """A method or dataset in a loose file; `path` is that file."""

    config: Mapping[str, Any] = field(default_factory=dict)  # what a yaml would hold

    @property
    def description(self) -> str:
        """The first line of its docstring."""
        return (inspect.getdoc(self.target()) or "").partition("\n")[0]

    def values(self) -> dict[str, Any]:
        """Return its class or function and the defaults of its options."""
        return dict(self.config)


def names_a_file(text: str) -> bool:
    """Tell whether a method or dataset is named by its file and class, as in ./mine.py:MyMethod."""
    return _NAMED.fullmatch(text) is not None


def load(group: Group, text: str) -> LooseEntry:
    """Import a file and return what `text` names in it; raises BadInput in one line, with file and line of an error."""
    parts = _NAMED.fullmatch(text)
    assert parts is not None
    file = Path(parts["file"]).expanduser()
    module = _imported(file)
    name = parts["name"] or _only_one(group, module, file)
    found = getattr(module, name, None)
    if not callable(found):
        known = [n for n, value in vars(module).items() if getattr(value, "__module__", "") == module.__name__]
        raise BadInput(
            f"{group}={text}: {file} defines no class or function {name}" + (f": {near(name, known)}" if known else "")
        )
    values = {"_target_": f"{module.__name__}.{name}", **_defaults(group, found)}
    return LooseEntry(group, name, file.absolute(), str(file), f"{file}:{name}", values)


def _imported(file: Path) -> ModuleType:
    path = file.absolute()
    name = path.stem
    for known in (sys.modules.get(name), sys.modules.get(_by_path(path))):
        if getattr(known, "__file__", None) == str(path):
            return known  # type: ignore[return-value]
    if not path.is_file():
        raise BadInput(f"{file} is not there: give the path of the Python file, as in ./mine.py:MyMethod")
    sys.path.append(str(path.parent))  # for what it imports from beside itself
    taken = importlib.util.find_spec(name) if name.isidentifier() else None
    if not name.isidentifier() or name in sys.modules or (taken and taken.origin != str(path)):
        name = _by_path(path)
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # where a dataclass and the hash of the code look for it
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        raise BadInput(f"{file} cannot be imported: {describe_error(error, str(path))}") from error
    return module


def _by_path(path: Path) -> str:
    """Return a name for a file whose own name something else has."""
    return f"{re.sub(r'[^A-Za-z0-9_]', '_', path.stem)}_{hashlib.sha256(str(path).encode()).hexdigest()[:8]}"


def _only_one(group: Group, module: ModuleType, file: Path) -> str:
    """Return the name of the only method or dataset that a file defines."""
    from vprbench.api.method import Method

    own = {name: v for name, v in vars(module).items() if getattr(v, "__module__", "") == module.__name__}
    if group == "method":
        found = [name for name, value in own.items() if inspect.isclass(value) and issubclass(value, Method)]
    else:
        returned = {name: getattr(value, "__annotations__", {}).get("return") for name, value in own.items()}
        found = [name for name, kind in returned.items() if getattr(kind, "__name__", kind) == "Dataset"]
    if len(found) != 1:
        some = f"defines {', '.join(found)}" if found else f"defines no {group}"
        raise BadInput(f"{group}={file}: it {some}; name one, as in {group}={file}:{(found or ['name'])[0]}")
    return found[0]


def _defaults(group: Group, target: Any) -> dict[str, Any]:
    """Return the parameters of a class or function with their defaults; ??? stands for none, as Hydra has it."""
    made = {f.name: f.default_factory for f in dataclasses.fields(target)} if dataclasses.is_dataclass(target) else {}
    found: dict[str, Any] = {}
    for name, parameter in inspect.signature(target).parameters.items():
        if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            continue
        factory = made.get(name, dataclasses.MISSING)
        value = parameter.default if factory is dataclasses.MISSING else factory()
        if group == "method" and name in _OF_THE_RUN:
            found[name] = f"${{{name}}}"
        elif value is parameter.empty:
            found[name] = "???"
        elif _is_plain(value := str(value) if isinstance(value, Path) else value):
            found[name] = _plain(value)
    return found


def _is_plain(value: Any) -> bool:
    if isinstance(value, Mapping):
        return all(isinstance(name, str) and _is_plain(inner) for name, inner in value.items())
    if isinstance(value, list | tuple):
        return all(map(_is_plain, value))
    return value is None or isinstance(value, bool | int | float | str)


def _plain(value: Any) -> Any:
    return [_plain(inner) for inner in value] if isinstance(value, tuple | list) else value
