"""The names of methods and datasets, found as yaml files, and the configured objects behind them."""

from __future__ import annotations

import importlib.util
import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, is_dataclass
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar, Literal, cast, get_args, get_type_hints

import yaml
from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.plugins import Plugins
from hydra.plugins.search_path_plugin import SearchPathPlugin
from hydra.utils import get_object
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from vprbench import ending
from vprbench.api.dataset import Dataset
from vprbench.api.method import Method
from vprbench.errors import BadInput
from vprbench.plugins.checked import checked as checked
from vprbench.plugins.returned_dataset import disk_errors_told, insist_on_dataset
from vprbench.text import near as near  # for the commands too

Group = Literal["method", "dataset"]

ENTRY_POINTS = "vprbench.conf"

_DECLARED = "tuned_on"  # of a method: what its yaml says of its settings, no argument
_NO_CHOICE = ("_target_", "defaults", "seed", "device", _DECLARED)  # what every run sets for itself


@dataclass(frozen=True)
class TunedOn:
    """The places on which the settings of a method were chosen: the key `tuned_on` of its yaml."""

    dataset: str  # its name, as runs hold it
    places: str  # in words: the first 1000 places
    also_in: tuple[str, ...] = ()  # datasets that show these places under other names

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}


@dataclass(frozen=True)
class Entry:
    """One registered method or dataset: its yaml and who provides it."""

    group: Group
    name: str
    path: Path
    provider: str

    @property
    def description(self) -> str:
        """The first comment line of the yaml."""
        first = self.path.read_text(encoding="utf-8").splitlines()[:1]
        return first[0].lstrip("# ").strip() if first and first[0].startswith("#") else ""

    @property
    def options(self) -> list[str]:
        """The names of the arguments that the yaml holds, those of the one it builds on included."""
        return [str(name) for name in self._values() if name not in ("_target_", "defaults", _DECLARED)]

    @property
    def tuned_on(self) -> dict[str, Any]:
        """Return the places on which the yaml, or what it builds on, says that its settings were chosen.

        These are the values of `TunedOn`; empty if none are declared. Raises BadInput that names the yaml.
        """
        return _tuned_on(self._values().get(_DECLARED), self.path)

    def changed(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        """Return the `arguments` that differ from the values of the yaml and of the yamls it builds on.

        Seed and device do not count, nor does what the yaml interpolates (`${...}`). Of a nested mapping only what
        differs is returned.
        """
        own = OmegaConf.to_container(self._values())
        given = {name: value for name, value in arguments.items() if name not in _NO_CHOICE}
        return _different(given, cast(dict[Any, Any], own))

    def target(self) -> Callable[..., Any]:
        """Import and return the class or function, its own or that of the one it builds on.

        Raises BadInput with the reason if the import fails.
        """
        try:
            return _locate(self._values()["_target_"])
        except (yaml.YAMLError, OmegaConfBaseException, OSError) as error:
            reason = str(error).splitlines()[0]
            raise BadInput(f"{self.path} is no {self.group} ({reason}): a yaml with _target_ is wanted") from error

    def beside(self, module: str) -> ModuleType:
        """Import and return a module of the package of the class or function, such as what a benchmark asks for."""
        return importlib.import_module(f"{self.target().__module__.rpartition('.')[0]}.{module}")

    def _values(self) -> DictConfig:
        """Return the values of the yaml, merged over the values of the yamls it builds on."""
        content = OmegaConf.load(self.path)
        if not isinstance(content, DictConfig):
            return OmegaConf.create()
        known = entries(self.group)
        named = [base for base in content.get("defaults", []) if isinstance(base, str) and base != self.name]
        return cast(DictConfig, OmegaConf.merge(*(known[base]._values() for base in named if base in known), content))


def entries(group: Group) -> dict[str, Entry]:
    """Return the registered methods or datasets by name; imports none of them.

    If several share a name, it is this project's own method or dataset, or none.
    """
    usable = {name: few[0] for name, few in _offered(group).items() if len(few) == 1 or few[0].provider == "vprbench"}
    return dict(sorted(usable.items()))


def insist_on_one(group: Group, name: str) -> None:
    """Raise BadInput if several plug-ins bring a method or dataset of one name."""
    offers = _offered(group).get(name, ())
    if len(offers) > 1 and offers[0].provider != "vprbench":
        both = " and ".join(entry.provider for entry in offers)
        raise BadInput(f"{group}={name} comes from plug-ins {both}, and none is used: rename or uninstall one")


def _offered(group: Group) -> dict[str, list[Entry]]:
    """Return all methods or datasets by name, this project's own first."""
    offered: dict[str, list[Entry]] = {}
    for provider, folder in conf_folders().items():
        for path in sorted((folder / group).glob("*.yaml")):
            offered.setdefault(path.stem, []).append(Entry(group, path.stem, path, provider))
    return offered


def conf_folders() -> dict[str, Path]:
    """Return the folders that hold method/ and dataset/, by provider: this project's and those of plug-ins."""
    plugins = {name: found for name, found in _plugins().items() if isinstance(found, Path)}
    return {"vprbench": _package_folder("vprbench.conf"), **plugins}


def broken_plugins() -> Iterator[tuple[str, str]]:
    """Yield the installed plug-ins of which something is not used, with the reason."""
    yield from ((name, found) for name, found in _plugins().items() if isinstance(found, str))
    for group in get_args(Group):
        for name, offers in _offered(group).items():
            for entry in offers[len(offers) == 1 or offers[0].provider == "vprbench" :]:
                others = " and ".join(other.provider for other in offers if other is not entry)
                yield entry.provider, f"its {group} {name} is not used, for {others} has one of that name too"


def declared(name: str, config: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the arguments in a method's configuration, and apart from them on what its settings were chosen.

    Raises BadInput if a registered method was asked for with another `tuned_on` than its yaml has.
    """
    entry = entries("method").get(name)
    asked = _tuned_on(config.get(_DECLARED), f"method {name}")
    if entry is not None and asked != entry.tuned_on:
        raise BadInput(f"method.{_DECLARED}={asked or None}: what {name} was tuned on is told by {entry.path} alone")
    return arguments(config), asked


def arguments(config: Mapping[str, Any]) -> dict[str, Any]:
    """Return a method's configuration without what its yaml declares beside the arguments."""
    return {name: value for name, value in config.items() if name != _DECLARED}


def make_method(config: Mapping[str, Any]) -> Method:
    """Build a method from its configuration; raises BadInput for arguments that do not fit."""
    method = _build("method", arguments(config))
    if not isinstance(method, Method):
        raise BadInput(f"{config['_target_']} made a {type(method).__name__}; a method has to subclass Method")
    return method


def make_dataset(config: Mapping[str, Any]) -> Dataset:
    """Build a dataset from its configuration; raises BadInput for arguments or data that do not fit."""
    with disk_errors_told(str(config.get("name", ""))):
        dataset = _build("dataset", config)
    return insist_on_dataset(dataset, config["_target_"])


def register_search_path() -> None:
    """Let Hydra find the yaml files of installed plug-ins."""
    Plugins.instance().register(_PluginSearchPath)


class _PluginSearchPath(SearchPathPlugin):
    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        for provider, folder in conf_folders().items():
            if provider != "vprbench":
                search_path.append(provider=provider, path=f"file://{folder}")


def _plugins() -> dict[str, Path | str]:
    """Return by the name of its entry point the folder of each plug-in, or the reason why the plug-in is not used."""
    points: dict[str, list[EntryPoint]] = {}
    for point in sorted(entry_points(group=ENTRY_POINTS), key=lambda point: point.name):
        points.setdefault(point.name, []).append(point)
    found: dict[str, Path | str] = {}
    for name, shared in points.items():
        if len(shared) > 1 or name == "vprbench":
            packages = " and ".join(point.dist.name if point.dist else point.value for point in shared)
            owners = packages + " and by this project" * (name == "vprbench")
            found[name] = f"the entry point is named so by {owners}, and no plug-in of that name is used"
            continue
        try:
            folder = _package_folder(shared[0].value)
            found[name] = folder if folder.is_dir() else f"{folder} does not exist"
        except ModuleNotFoundError as error:
            found[name] = str(error)
    return found


def _package_folder(name: str) -> Path:
    """Return the folder of a package without importing it."""
    top, *rest = name.split(".")
    spec = importlib.util.find_spec(top)
    if spec is None or not spec.submodule_search_locations:
        raise ModuleNotFoundError(f"package {top} is not installed")
    if top == "vprbench":  # in a checkout conf/ stands beside the package
        import vprbench

        candidates = [Path(location).joinpath(*rest) for location in vprbench.__path__]
    else:
        candidates = [Path(location).joinpath(*rest) for location in spec.submodule_search_locations]
    return next((folder for folder in candidates if folder.is_dir()), candidates[0])


def _locate(target: str) -> Callable[..., Any]:
    """Import what a dotted path names; raises BadInput with the reason."""
    try:
        ending.tell(doing=f"importing {target}")
        found = get_object(target)
        ending.tell(doing=None)
    except (
        Exception,
        SystemExit,
    ) as error:  # a plug-in may fail in any way, and must hurt only itself
        cause = error.__cause__ or error
        reason = (str(cause).splitlines() or [""])[0] or type(cause).__name__
        raise BadInput(f"{target} cannot be imported: {reason}") from error
    if not callable(found):
        raise BadInput(f"{target} is a {type(found).__name__}, not a class or function")
    return found  # type: ignore[no-any-return]


def _build(group: Group, config: Mapping[str, Any]) -> Any:
    if "_target_" not in config:
        raise BadInput(
            f"the yaml of {group} {config.get('name', '')} has no _target_: name its function or class there"
        )
    target = _locate(config["_target_"])
    arguments = {name: value for name, value in config.items() if name != "_target_"}
    known = inspect.signature(target).parameters
    plain_class = inspect.isclass(target) and not is_dataclass(target)
    hints = get_type_hints(target.__init__ if plain_class else target)
    for name, value in arguments.items():
        if name not in known:
            raise BadInput(f"{group}.{name} is unknown to {config['_target_']}: {near(name, known)}")
        arguments[name] = checked(f"{group}.{name}", value, hints.get(name, Any))
    missing = [n for n, p in known.items() if p.default is p.empty and p.kind < p.VAR_POSITIONAL and n not in arguments]
    if missing:
        raise BadInput(f"{group}.{missing[0]} is missing: {config['_target_']} has no default for it")
    return target(**arguments)


def _tuned_on(given: Any, where: object) -> dict[str, Any]:
    """Return a declared `tuned_on` as plain values; raises BadInput that names the yaml or method."""
    if given is None:
        return {}
    plain = OmegaConf.to_container(given) if OmegaConf.is_config(given) else given
    known: TunedOn = checked(f"{where}: {_DECLARED}", plain, TunedOn)
    return {**asdict(known), "also_in": [*known.also_in]}


def _different(given: Mapping[str, Any], own: Mapping[Any, Any]) -> dict[str, Any]:
    """Return what `given` holds and `own` does not, or with another value; interpolations equal everything."""
    found = {}
    for name, value in given.items():
        known = own.get(name)
        if isinstance(value, Mapping) and isinstance(known, Mapping):
            if inner := _different(value, known):
                found[name] = inner
        elif (name not in own or value != known) and "${" not in str(known):
            found[name] = value
    return found
