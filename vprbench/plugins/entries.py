"""The registered methods and datasets: found as yaml files, and read without Hydra, PyTorch or any plug-in."""

from __future__ import annotations

import importlib.util
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, ClassVar, Literal, get_args

import yaml

from vprbench.errors import BadInput
from vprbench.plugins.tuned_places import parse_tuned_on

Group = Literal["method", "dataset"]

ENTRY_POINTS = "vprbench.conf"

#: What the yaml of a method or dataset says of it beside its arguments.
DECLARED = ("tuned_on", "tags", "on_disk")
_NO_ARGUMENTS = ("_target_", *DECLARED)
_NO_CHOICE = (*_NO_ARGUMENTS, "seed", "device")  # what every run sets for itself


_LOOSE: dict[Group, dict[str, Entry]] = {"method": {}, "dataset": {}}  # of loose files, by name


@dataclass(frozen=True)
class Entry:
    """One registered method or dataset: its yaml and who provides it."""

    group: Group
    name: str
    path: Path
    provider: str
    plugin_path: str = ""  # of one in a loose file: what another process knows it by

    @property
    def description(self) -> str:
        """The first comment line of the yaml."""
        first = self.path.read_text(encoding="utf-8").splitlines()[:1]
        return first[0].lstrip("# ").strip() if first and first[0].startswith("#") else ""

    @property
    def options(self) -> list[str]:
        """The names of the arguments that the yaml holds, those of the one it builds on included."""
        return [str(name) for name in self.values() if name not in _NO_ARGUMENTS]

    @property
    def tags(self) -> tuple[str, ...]:
        """Words that the yaml, or what it builds on, declares the method to be: spiking."""
        return declared_tags(self.values().get("tags"), self.path)

    @property
    def spiking(self) -> bool:
        """Whether it says that it computes by spikes."""
        return "spiking" in self.tags

    @property
    def needs_weights(self) -> bool:
        """Whether it needs weights that have to be fetched: its yaml has a mapping `weights` that names no package."""
        weights = self.values().get("weights")
        return isinstance(weights, Mapping) and not weights.get("package")

    @property
    def tuned_on(self) -> dict[str, Any]:
        """Return the places on which the yaml, or what it builds on, says that its settings were chosen.

        These are the values of `TunedOn`; empty if none are declared. Raises BadInput that names the yaml.
        """
        return parse_tuned_on(self.values().get("tuned_on"), self.path)

    def changed(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        """Return the `arguments` that differ from the values of the yaml and of the yamls it builds on.

        Seed and device do not count, nor does what the yaml interpolates (`${...}`). Of a nested mapping only what
        differs is returned.
        """
        given = {name: value for name, value in arguments.items() if name not in _NO_CHOICE}
        return _different(given, self.values())

    def target(self) -> Callable[..., Any]:
        """Import and return the class or function, its own or that of the one it builds on.

        Raises BadInput with the reason if the import fails.
        """
        from vprbench.plugins.registry import located

        return located(self.group, self.values(), self.path)

    def values(self) -> dict[str, Any]:
        """Return the values of the yaml, merged over those of the yamls it builds on, interpolations as they stand.

        Raises BadInput that names a yaml that cannot be read.
        """
        merged: dict[str, Any] = {}
        for base in self.bases():
            merged = _merged(merged, base.values())
        return _merged(merged, {name: value for name, value in self._content().items() if name != "defaults"})

    def bases(self) -> list[Entry]:
        """Return the yamls that this one builds on, in their order; raises BadInput if it cannot be read."""
        names = [base for base in self._content().get("defaults") or () if isinstance(base, str)]
        found = [self._below(name) for name in names if name not in ("_self_", self.name)]
        return [base for base in found if base is not None]

    def _content(self) -> dict[str, Any]:
        try:
            content = read(self.path.read_text(encoding="utf-8"))
        except (yaml.YAMLError, OSError, UnicodeDecodeError) as error:
            mark = getattr(error, "problem_mark", None)
            where = f", line {mark.line + 1}" if mark else ""
            reason = getattr(error, "problem", None) or str(error).splitlines()[0]
            raise BadInput(
                f"{self.path}{where} is no {self.group} ({reason}): a yaml with _target_ is wanted"
            ) from error
        return content if isinstance(content, dict) else {}

    def _below(self, name: str) -> Entry | None:
        if name.startswith("/"):  # shared lines, as in /shared/index@_here_; they may name others of their folder
            return self._beside(name[1:].partition("@")[0])
        if self.path.parent.name == "shared":
            return self._beside(f"shared/{name}")
        own = Entry(self.group, name, self.path.with_name(f"{name}.yaml"), self.provider)
        if self.provider == "vprbench" and own.path.is_file():  # nobody else has to be asked
            return own
        return entries(self.group).get(name)

    def _beside(self, name: str) -> Entry | None:
        paths = (folder / f"{name}.yaml" for folder in conf_folders().values())
        return next((Entry(self.group, name, path, self.provider) for path in paths if path.is_file()), None)


def entries(group: Group) -> dict[str, Entry]:
    """Return the registered methods or datasets by name; imports none of them.

    If several share a name, it is this project's own method or dataset, or none.
    """
    usable = {name: few[0] for name, few in _offered(group).items() if len(few) == 1 or few[0].provider == "vprbench"}
    return dict(sorted({**usable, **_LOOSE[group]}.items()))


def add(entry: Entry) -> None:
    """Register the method or dataset of a loose file in this process; raises BadInput if its name is another's."""
    for name, other in entries(entry.group).items():
        if name.casefold() == entry.name.casefold() and other.path != entry.path:
            raise BadInput(f"{entry.group}={entry.path}:{entry.name}: {other.path} has that name too: rename yours")
    _LOOSE[entry.group][entry.name] = entry


def with_plugin_paths(option: str) -> str:
    """Return an option method=NAME or dataset=NAME as another process understands it: with a loose file's path."""
    group, equals, names = option.partition("=")
    loose = {name: entry.plugin_path for known in _LOOSE for name, entry in _LOOSE[known].items() if known == group}
    return f"{group}=" + ",".join(loose.get(name, name) for name in names.split(",")) if equals and loose else option


def require_one(group: Group, name: str) -> None:
    """Raise BadInput if several plug-ins bring a method or dataset of one name."""
    offers = _offered(group).get(name, ())
    if len(offers) > 1 and offers[0].provider != "vprbench":
        both = " and ".join(entry.provider for entry in offers)
        raise BadInput(f"{group}={name} comes from plug-ins {both}, and none is used: rename or uninstall one")


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


def declared_tags(given: Any, where: object) -> tuple[str, ...]:
    """Return declared `tags`; raises BadInput that names the yaml or method."""
    if given is not None and not (isinstance(given, list) and all(isinstance(tag, str) for tag in given)):
        raise BadInput(f"{where}: tags={given}: wanted a list of words, as in [spiking]")
    return tuple(given or ())


def _offered(group: Group) -> dict[str, list[Entry]]:
    """Return all methods or datasets by name, this project's own first."""
    offered: dict[str, list[Entry]] = {}
    for provider, folder in conf_folders().items():
        for path in sorted((folder / group).glob("*.yaml")):
            offered.setdefault(path.stem, []).append(Entry(group, path.stem, path, provider))
    return offered


@cache
def _entry_points(folders: tuple[tuple[str, int], ...]) -> tuple[EntryPoint, ...]:
    """Return the entry points of plug-ins by name, looked up again once a folder of Python's path has changed."""
    return tuple(sorted(entry_points(group=ENTRY_POINTS), key=lambda point: point.name))


def _changed(folder: str) -> int:
    """Return when a folder was changed, in nanoseconds; 0 if there is none."""
    try:
        return Path(folder or ".").stat().st_mtime_ns
    except OSError:
        return 0


def _plugins() -> dict[str, Path | str]:
    """Return by the name of its entry point the folder of each plug-in, or the reason why the plug-in is not used."""
    points: dict[str, list[EntryPoint]] = {}
    for point in _entry_points(tuple((folder, _changed(folder)) for folder in sys.path)):
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


def _merged(below: Mapping[Any, Any], above: Mapping[Any, Any]) -> dict[Any, Any]:
    """Return `above` laid over `below`, mappings within them likewise."""
    both = {name for name in above if isinstance(above[name], dict) and isinstance(below.get(name), dict)}
    return {**below, **above, **{name: _merged(below[name], above[name]) for name in both}}


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


@cache
def read(text: str) -> Any:
    """Return what a yaml holds, as Hydra would read it; the same object for the same text."""
    return yaml.load(text, _Loader)


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """Reads a yaml as Hydra does: 1e-3 is a number, and a date is a text."""

    yaml_implicit_resolvers: ClassVar[dict[str, Any]] = {
        first: [(tag, rule) for tag, rule in rules if not tag.endswith(":timestamp")]
        for first, rules in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?[0-9][0-9_]*(\.[0-9_]*)?[eE][-+]?[0-9]+$"), list("-+0123456789")
)
