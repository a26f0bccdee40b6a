"""Loose files: a method or dataset by the path of its file, ./mine.py:MyMethod, registered in this process."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import re
import sys
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any, get_args

from hydra.core.config_store import ConfigStore
from pydantic_core import PydanticSerializationError, to_jsonable_python

from vprbench.errors import BadInput
from vprbench.plugins.entries import Entry, Group, register_entry
from vprbench.plugins.registry import describe_error
from vprbench.text import suggest_names

_LOOSE_FILE = re.compile(r"(?P<file>[^][,()'\"]+\.py)(?::(?P<name>\w+))?")
_RUN_ARGUMENTS = ("seed", "device")  # parameters of a method that take the values of the run


def resolve_name(group: Group, text: str) -> str:
    """Return the name of a method or dataset; one in a loose file, ./mine.py:MyMethod, is registered by it first.

    Raises BadInput if the file cannot be imported (with file and line of the error), has the name of another module or
    has no such class or function, or if the name is another's.
    """
    parts = _LOOSE_FILE.fullmatch(text)
    if parts is None:
        return text
    file, name = Path(parts["file"]).expanduser(), parts["name"]
    if name is None:
        raise BadInput(f"{group}={text}: name its class or function, as in {group}={file}:Mine")
    module = _import_file(file)
    target = getattr(module, name, None)
    if not callable(target):
        own = [one for one, value in vars(module).items() if getattr(value, "__module__", "") == module.__name__]
        hint = f": {suggest_names(name, own)}" if own else ""
        raise BadInput(f"{group}={text}: {file} defines no class or function {name}{hint}")
    config = {"_target_": f"{module.__name__}.{name}", **_list_defaults(group, target)}
    register_entry(Entry(group, name, file.absolute(), str(file), config=config))
    ConfigStore.instance().store(group=group, name=name, node=config)
    return name


def register_loose_file(option: str) -> None:
    """Register what method=./mine.py:MyMethod or dataset=./mine.py:my_dataset names; any other option is ignored."""
    group, _, name = option.partition("=")
    if group in get_args(Group):
        resolve_name("method" if group == "method" else "dataset", name)


def _import_file(file: Path) -> ModuleType:
    path = file.absolute()
    if not path.is_file():
        raise BadInput(f"{file} is not there: give the path of the Python file, as in ./mine.py:MyMethod")
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))  # also for its imports from beside itself
    importlib.invalidate_caches()
    try:
        module = importlib.import_module(path.stem)
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
