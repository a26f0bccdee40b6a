"""A method or dataset in a loose file, ./mine.py:MyMethod: imported from its path, its parameters its options."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import os
import re
import sys
import traceback
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any

from pydantic_core import PydanticSerializationError, to_jsonable_python

from vprbench.errors import BadInput
from vprbench.plugins.entries import Entry, Group
from vprbench.text import near

#: Parts of the file names of frames that lie between the harness and a plug-in.
_NO_PLUGINS = (str(Path(__file__).parents[1]), "importlib", "<frozen")
_LOOSE_FILE = re.compile(r"(?P<file>[^][,()'\"]+\.py)(?::(?P<name>\w+))?")
_RUN_ARGUMENTS = ("seed", "device")  # parameters of a method that take the values of the run


def is_loose_file(text: str) -> bool:
    """Tell whether a method or dataset is named by its file and class, as in ./mine.py:MyMethod."""
    return _LOOSE_FILE.fullmatch(text) is not None


def load_loose_file(group: Group, text: str) -> Entry:
    """Import a file and return the method or dataset that `text` names in it.

    Raises:
        BadInput: the file cannot be imported (one line, with file and line of the error), has the name of another
            module, or has no such class or function.
    """
    parts = _LOOSE_FILE.fullmatch(text)
    assert parts is not None
    file, name = Path(parts["file"]).expanduser(), parts["name"]
    if name is None:
        raise BadInput(f"{group}={text}: name its class or function, as in {group}={file}:Mine")
    module = _import_file(file)
    target = getattr(module, name, None)
    if not callable(target):
        own = [one for one, value in vars(module).items() if getattr(value, "__module__", "") == module.__name__]
        hint = f": {near(name, own)}" if own else ""
        raise BadInput(f"{group}={text}: {file} defines no class or function {name}{hint}")
    config = {"_target_": f"{module.__name__}.{name}", **_list_defaults(group, target)}
    return Entry(group, name, file.absolute(), str(file), config=config)


def describe_error(error: BaseException) -> str:
    """Return an error in one line, with the innermost place in the folder of the plug-in that raised it."""
    if isinstance(error, SyntaxError):
        return f"SyntaxError: {error.msg}{_format_place(error.filename, error.lineno)}"
    text = (str(error).splitlines() or [""])[0]
    return f"{type(error).__name__}: {text}".removesuffix(": ") + locate_error(error)


def locate_error(error: BaseException) -> str:
    """Return the innermost place of an error in the folder of the plug-in, " (mine.py, line 3)"; empty for none."""
    places = [(frame.filename, frame.lineno) for frame in traceback.extract_tb(error.__traceback__)]
    others = [place for place in places if not any(part in place[0] for part in _NO_PLUGINS)]
    own = [place for place in others if place[0].startswith(os.path.dirname(others[0][0]))]  # noqa: PTH120 (also <string>)
    return _format_place(*own[-1]) if own else ""


def _format_place(file: str | None, line: int | None) -> str:
    path = Path(file or "")
    shown = path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path
    return f" ({shown}, line {line})" if file else ""


def _import_file(file: Path) -> ModuleType:
    path = file.absolute()
    if not path.is_file():
        raise BadInput(f"{file} is not there: give the path of the Python file, as in ./mine.py:MyMethod")
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))  # also for its imports from beside itself
    importlib.invalidate_caches()
    try:
        module = importlib.import_module(path.stem)  # noqa: TID251 (the user names the file)
    except (Exception, SystemExit) as error:
        raise BadInput(f"{file} cannot be imported: {describe_error(error)}") from error
    if Path(module.__file__ or "").resolve() != path.resolve():
        raise BadInput(f"{file}: another module has the name {path.stem} ({module.__file__}): rename the file")
    return module


def _list_defaults(group: Group, target: Any) -> dict[str, Any]:
    """Return the parameters of a class or function with their defaults; ??? stands for none, as Hydra has it.

    A default that JSON cannot hold is left to the class or function.
    """
    fields = dataclasses.fields(target) if dataclasses.is_dataclass(target) else ()
    factories = {field.name: field.default_factory for field in fields if callable(field.default_factory)}
    defaults: dict[str, Any] = {}
    for name, parameter in inspect.signature(target).parameters.items():
        value = factories[name]() if name in factories else parameter.default
        with suppress(PydanticSerializationError):
            defaults[name] = "???" if value is parameter.empty else to_jsonable_python(value)
    return defaults | {name: f"${{{name}}}" for name in _RUN_ARGUMENTS if group == "method" and name in defaults}
