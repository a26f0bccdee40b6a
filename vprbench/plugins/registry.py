"""The objects behind the names of methods and datasets: imported, configured and checked."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import os
import traceback
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any, Unpack, get_args, get_origin, get_type_hints

from vprbench.api.dataset import Dataset, SharedFrames
from vprbench.api.images import Images
from vprbench.api.method import Method
from vprbench.errors import BadInput
from vprbench.plugins.entries import DECLARED, Entry, Group, find_conf_folders, find_entries
from vprbench.plugins.options import check_value, check_values

__all__ = ["check_value", "find_conf_folders", "find_entries"]  # of other modules, for callers of this one

#: Parts of the names of source files that lie between the harness and a plug-in.
_HARNESS_FILES = (str(Path(__file__).parents[1]), "importlib", "<frozen")


def take_arguments(config: Mapping[str, Any]) -> dict[str, Any]:
    """Return a configuration without the declarations of its yaml beside the arguments."""
    return {name: value for name, value in config.items() if name not in DECLARED}


def make_method(config: Mapping[str, Any]) -> Method:
    """Build a method from its configuration; raises BadInput for arguments that do not fit."""
    method = _build_plugin("method", config)
    if not isinstance(method, Method):
        raise BadInput(f"{config['_target_']} made a {type(method).__name__}; a method has to subclass Method")
    return method


def make_dataset(config: Mapping[str, Any]) -> Dataset:
    """Build a dataset from its configuration; raises BadInput for arguments or data that do not fit.

    `shared_frames` is an option of every dataset, and no argument of the function that makes it.
    """
    shared = check_value("dataset.shared_frames", config.get("shared_frames", "error"), SharedFrames)
    try:
        dataset = _build_plugin("dataset", {name: value for name, value in config.items() if name != "shared_frames"})
    except OSError as error:  # as for a path that no disk takes
        raise BadInput(f"dataset {config.get('name', '')} cannot be read ({error}): correct the path") from error
    if not isinstance(dataset, Dataset):
        raise BadInput(f"{config['_target_']} gave {type(dataset).__name__}; it has to return a Dataset")
    if not isinstance(dataset.references, Images) or not isinstance(dataset.queries, Images):
        wanted = "make references and queries by Images.from_files(paths) or Images.from_arrays(arrays)"
        raise BadInput(f"{config['_target_']} gave no Images: {wanted}")
    return dataset.with_shared_frames(shared)


def check_arguments(group: Group, config: Mapping[str, Any]) -> tuple[Callable[..., Any], dict[str, Any]]:
    """Return the class or function of a configuration, and its arguments as it is given them.

    Raises BadInput for an argument that is unknown or not of the type that the type hint names.
    """
    target = find_target(group, config, f"the yaml of {group} {config.get('name', '')}")
    plain_class = inspect.isclass(target) and not dataclasses.is_dataclass(target)
    try:
        hints = get_type_hints(target.__init__ if plain_class else target)
        known: dict[str, Any] = {}
        for name in inspect.signature(target).parameters:
            hint = hints.get(name, Any)
            known |= get_type_hints(get_args(hint)[0]) if get_origin(hint) is Unpack else {name: hint}
    except Exception as error:  # hints are evaluated, and may raise anything
        raise BadInput(f"{config['_target_']}: its type hints cannot be read ({error}): import their names") from error
    given = {name: value for name, value in take_arguments(config).items() if name != "_target_" and value != "???"}
    return target, check_values(f"{group}.", given, known)


def list_data_files(method: Method, config: Mapping[str, Any]) -> list[Path]:
    """Return `files()` of a method, then the files that its arguments name; raises BadInput as `files()` does."""
    named = [*method.files()]
    known = {Path(path).expanduser().resolve() for path in named}
    texts = map(os.path.expanduser, _list_texts(take_arguments(config)))
    others = {Path(text).resolve(): Path(text) for text in texts if os.path.isfile(text)}  # noqa: PTH113 (Path's raises)
    return [*named, *(path for whole, path in others.items() if whole not in known)]


def find_target(group: str, config: Mapping[str, Any], where: object) -> Callable[..., Any]:
    """Import and return the class or function of a configuration; raises BadInput with the reason.

    `where` names the configuration that has to name one.
    """
    target = config.get("_target_")
    if not isinstance(target, str):
        raise BadInput(f"{where} is no {group} (it has no _target_): name its class or function there")
    module, _, name = target.rpartition(".")
    try:
        found = getattr(importlib.import_module(module), name)
    except (Exception, SystemExit) as error:  # a plug-in may fail in any way, and must hurt only itself
        raise BadInput(f"{target} cannot be imported: {describe_error(error)}") from error
    return found  # type: ignore[no-any-return]


def find_module_beside(entry: Entry, module: str) -> ModuleType:
    """Import and return a module of the package of a method or dataset, such as the readers of `folders`."""
    return importlib.import_module(f"{entry.target().__module__.rpartition('.')[0]}.{module}")


def describe_error(error: BaseException) -> str:
    """Return an error in one line, with the innermost place in the folder of the plug-in that raised it."""
    if isinstance(error, SyntaxError):
        return f"SyntaxError: {error.msg}{_format_place(error.filename, error.lineno)}"
    text = (str(error).splitlines() or [""])[0]
    return f"{type(error).__name__}: {text}".removesuffix(": ") + locate_error(error)


def locate_error(error: BaseException) -> str:
    """Return the innermost place of an error in the folder of the plug-in, " (mine.py, line 3)"; empty for none."""
    places = [(frame.filename, frame.lineno) for frame in traceback.extract_tb(error.__traceback__)]
    others = [place for place in places if not any(part in place[0] for part in _HARNESS_FILES)]
    own = [place for place in others if place[0].startswith(os.path.dirname(others[0][0]))]  # noqa: PTH120 (also <string>)
    return _format_place(*own[-1]) if own else ""


def _build_plugin(group: Group, config: Mapping[str, Any]) -> Any:
    target, given = check_arguments(group, config)
    try:
        return target(**given)
    except (BadInput, OSError):
        raise
    except Exception as error:  # a plug-in may raise anything
        reason = describe_error(error)
        raise BadInput(f"{config['_target_']} fails when it is made: {reason}") from error


def _list_texts(value: Any) -> Iterator[str]:
    """Yield the texts among arguments, however deep, but for `_target_`."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        value = [inner for name, inner in value.items() if name != "_target_"]
    for inner in value if isinstance(value, list | tuple) else ():
        yield from _list_texts(inner)


def _format_place(file: str | None, line: int | None) -> str:
    path = Path(file or "")
    shown = path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path
    return f" ({shown}, line {line})" if file else ""
