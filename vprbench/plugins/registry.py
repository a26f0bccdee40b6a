"""The objects behind the names of methods and datasets: imported, configured and checked."""

from __future__ import annotations

import importlib
import inspect
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import is_dataclass
from types import ModuleType
from typing import Any, get_args, get_type_hints

from hydra.core.config_store import ConfigStore
from hydra.utils import get_object

from vprbench.api.dataset import Dataset, SharedFrames
from vprbench.api.method import Method
from vprbench.errors import BadInput
from vprbench.plugins import entries as yamls
from vprbench.plugins import local_plugins
from vprbench.plugins.entries import Entry as Entry
from vprbench.plugins.entries import Group as Group
from vprbench.plugins.entries import broken_plugins as broken_plugins
from vprbench.plugins.entries import conf_folders as conf_folders
from vprbench.plugins.entries import entries as entries
from vprbench.plugins.entries import with_plugin_paths as with_plugin_paths
from vprbench.plugins.local_plugins import describe_error
from vprbench.plugins.values import check_value as check_value
from vprbench.text import near as near  # for the commands too

_MOST_NAME_BYTES = 200  # file systems take 255, and other names are made of this one
_SHOWN = 150  # characters of a name in a message


@contextmanager
def _explaining_disk_errors(name: str) -> Iterator[None]:
    """Turn an OSError, as for a path that no disk takes, into BadInput that names the path."""
    try:
        yield
    except OSError as error:
        reason = f"{_shorten(str(error.filename))}: {error.strerror}" if error.filename and error.strerror else error
        raise BadInput(f"dataset {_shorten(name)} cannot be read ({reason}): correct the path") from error


def require_dataset(made: Any, target: str) -> Dataset:
    """Return what `target` made; raises BadInput if it is no dataset of images, or its name is no folder's."""
    if not isinstance(made, Dataset):
        raise BadInput(f"{target} gave {type(made).__name__}; it has to return a Dataset")
    if len(os.fsencode(made.name)) > _MOST_NAME_BYTES:
        raise BadInput(
            f"dataset.name={_shorten(made.name)} has more than {_MOST_NAME_BYTES} bytes: give a shorter one, for its "
            "runs are stored in a folder of that name"
        )
    from vprbench.api.images import Images  # a list of names needs none

    for part, images in (("references", made.references), ("queries", made.queries)):
        if not isinstance(images, Images):
            raise BadInput(
                f"{target} gave {part} of type {type(images).__name__}; wanted is vprbench.api.images.Images, "
                "by Images.from_files(paths) or Images.from_arrays(arrays)"
            )
    return made


def _shorten(text: str) -> str:
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


def arguments(config: Mapping[str, Any]) -> dict[str, Any]:
    """Return a configuration without the declarations of its yaml beside the arguments."""
    return {name: value for name, value in config.items() if name not in yamls.DECLARED}


def make_method(config: Mapping[str, Any]) -> Method:
    """Build a method from its configuration; raises BadInput for arguments that do not fit."""
    method = _build("method", arguments(config))
    if not isinstance(method, Method):
        raise BadInput(f"{config['_target_']} made a {type(method).__name__}; a method has to subclass Method")
    return method


def make_dataset(config: Mapping[str, Any]) -> Dataset:
    """Build a dataset from its configuration; raises BadInput for arguments or data that do not fit.

    `shared_frames` is an option of every dataset, and no argument of the function that makes it.
    """
    own = {name: value for name, value in arguments(config).items() if name != "shared_frames"}
    shared = check_value("dataset.shared_frames", config.get("shared_frames", "error"), SharedFrames)
    with _explaining_disk_errors(str(config.get("name", ""))):
        dataset = _build("dataset", own)
    return require_dataset(dataset, config["_target_"]).with_shared_frames(shared)


def resolve_name(group: Group, text: str) -> str:
    """Return the name of a method or dataset; one in a loose file, ./mine.py:MyMethod, is registered by it first.

    Raises BadInput if the file cannot be imported, or if the name is another's.
    """
    if not local_plugins.is_loose_file(text):
        return text
    entry = local_plugins.load_loose_file(group, text)
    yamls.add(entry)
    ConfigStore.instance().store(group=group, name=entry.name, node=entry.values())
    return entry.name


def register_loose_file(option: str) -> None:
    """Register what method=./mine.py:MyMethod or dataset=./mine.py:my_dataset names; any other option is ignored."""
    for group in get_args(Group):
        if option.startswith(f"{group}="):
            resolve_name(group, option.partition("=")[2])


def find_target(group: str, config: Mapping[str, Any], where: object) -> Callable[..., Any]:
    """Import and return the class or function of a configuration; raises BadInput that says `where` none is named."""
    if not isinstance(config.get("_target_"), str):
        raise BadInput(f"{where} is no {group} (it has no _target_): name its class or function there")
    return _locate(config["_target_"])


def module_beside(entry: Entry, module: str) -> ModuleType:
    """Import and return a module of the package of a method or dataset, such as what a benchmark asks for."""
    return importlib.import_module(f"{entry.target().__module__.rpartition('.')[0]}.{module}")


def _locate(target: str) -> Callable[..., Any]:
    """Import what a dotted path names; raises BadInput with the reason."""
    try:
        found = get_object(target)
    except (Exception, SystemExit) as error:  # a plug-in may fail in any way, and must hurt only itself
        raise BadInput(f"{target} cannot be imported: {describe_error(error.__cause__ or error)}") from error
    if not callable(found):
        raise BadInput(f"{target} is a {type(found).__name__}, not a class or function")
    return found  # type: ignore[no-any-return]


def _build(group: Group, config: Mapping[str, Any]) -> Any:
    target = find_target(group, config, f"the yaml of {group} {config.get('name', '')}")
    arguments = {name: value for name, value in config.items() if name != "_target_" and value != "???"}
    known, hints = _read_signature(target, config["_target_"])
    for name, value in arguments.items():
        if name not in known:
            raise BadInput(f"{group}.{name} is unknown to {config['_target_']}: {near(name, known)}")
        arguments[name] = check_value(f"{group}.{name}", value, hints.get(name, Any))
    missing = [n for n, p in known.items() if p.default is p.empty and p.kind < p.VAR_POSITIONAL and n not in arguments]
    if missing:
        raise BadInput(f"{group}.{missing[0]} is missing: {config['_target_']} has no default for it")
    try:
        return target(**arguments)
    except (BadInput, OSError):
        raise
    except Exception as error:  # a plug-in may raise anything
        raise BadInput(f"{config['_target_']} fails when it is made: {describe_error(error)}") from error


def _read_signature(target: Callable[..., Any], name: str) -> tuple[Mapping[str, inspect.Parameter], dict[str, Any]]:
    """Return the parameters of a class or function and their type hints; raises BadInput if it has none to be read."""
    plain_class = inspect.isclass(target) and not is_dataclass(target)
    try:
        return inspect.signature(target).parameters, get_type_hints(target.__init__ if plain_class else target)
    except Exception as error:  # hints are evaluated, and may raise anything
        raise BadInput(f"the type hints of {name} cannot be read ({error}): import what they name") from error
