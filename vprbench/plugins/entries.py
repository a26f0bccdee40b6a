"""The registered methods and datasets: found as yaml files, and read without Hydra, PyTorch or any plug-in."""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Literal

import yaml

from vprbench.errors import BadInput

Group = Literal["method", "dataset"]
Folder = Literal["method", "dataset", "timing", "cluster"]

#: What the yaml of a method or dataset says of it beside its arguments.
DECLARED = ("tuned_on", "tags", "on_disk")

_LOOSE: dict[str, dict[str, Entry]] = {"method": {}, "dataset": {}}  # of loose files, by name


@dataclass(frozen=True)
class Entry:
    """One registered method or dataset, or the yaml of a timing protocol or batch system."""

    group: Folder
    name: str
    path: Path
    provider: str  # the package that brings it, or the path of a loose file
    rivals: tuple[str, ...] = ()  # other packages that bring the name
    config: Mapping[str, Any] | None = None  # of a loose file, as a yaml would hold it

    @property
    def description(self) -> str:
        """The first line of the yaml, if it is a comment."""
        first = self.path.read_text(encoding="utf-8").partition("\n")[0]
        return first.lstrip("# ").strip() if first.startswith("#") else ""

    @property
    def options(self) -> list[str]:
        """The names of the arguments in the yaml and in the yamls it builds on."""
        return [str(name) for name in self.values() if name not in ("_target_", *DECLARED)]

    @property
    def tags(self) -> tuple[str, ...]:
        """The words that the yaml declares, as `spiking`."""
        tags = self.values().get("tags") or []
        return tuple(map(str, tags)) if isinstance(tags, list) else (str(tags),)

    @property
    def needs_weights(self) -> bool:
        """Whether weights have to be fetched: the yaml has a mapping `weights` that names no package."""
        weights = self.values().get("weights")
        return isinstance(weights, Mapping) and not weights.get("package")

    def target(self) -> Callable[..., Any]:
        """Import and return the class or function; raises BadInput with the reason if the import fails."""
        from vprbench.plugins.registry import find_target

        return find_target(self.group, self.values(), self.path)

    def values(self) -> dict[str, Any]:
        """Return the values of the yaml over those of the yamls it builds on; interpolations and mappings stay whole.

        Hydra alone composes the values of a run. Raises BadInput for a name of two packages, and for a yaml that
        cannot be read.
        """
        if self.config is not None:
            return dict(self.config)
        below = {name: value for base in self.bases() for name, value in base.values().items()}
        return {**below, **{name: value for name, value in self._read_own_values().items() if name != "defaults"}}

    def bases(self) -> list[Entry]:
        """Return the yamls that this one builds on: `/shared/index@_here_`, or a name in the folder of this yaml."""
        given = self._read_own_values().get("defaults") or ()
        names = [name for name in given if isinstance(name, str) and name not in ("_self_", self.name)]
        above = self.path.parent.name
        paths = [name[1:].partition("@")[0] if name.startswith("/") else f"{above}/{name}" for name in names]
        found = [
            (package, folder / f"{path}.yaml") for path in paths for package, folder in find_conf_folders().items()
        ]
        return [Entry(self.group, path.stem, path, package) for package, path in found if path.is_file()]

    def _read_own_values(self) -> dict[str, Any]:
        if self.rivals:
            packages = " and from ".join((self.provider, *self.rivals))
            raise BadInput(f"{self.group}={self.name} comes from {packages}: rename it in one of them")
        try:
            content = read(self.path.read_text(encoding="utf-8"))
        except (yaml.YAMLError, OSError, UnicodeDecodeError) as error:
            reason = " ".join(str(error).split())
            raise BadInput(f"{self.path} is no {self.group} ({reason}): a yaml with _target_ is wanted") from error
        return content if isinstance(content, dict) else {}


def find_entries(group: Folder) -> dict[str, Entry]:
    """Return the registered methods or datasets, timing protocols or batch systems by name; imports none of them."""
    found: dict[str, Entry] = {}
    for package, folder in find_conf_folders().items():
        for path in (folder / group).glob("*.yaml"):
            other = found.get(path.stem)
            new = Entry(group, path.stem, path, package)
            found[path.stem] = replace(other, rivals=(*other.rivals, package)) if other else new
    return dict(sorted({**found, **_LOOSE.get(group, {})}.items()))


def find_default(group: Folder) -> str:
    """Return the name of the method, dataset or timing that a run has unless it names another one."""
    run = read((find_conf_folders()["vprbench"] / "run.yaml").read_text(encoding="utf-8"))
    return str(next(each[group] for each in run["defaults"] if isinstance(each, Mapping) and group in each))


def register_entry(entry: Entry) -> None:
    """Register the method or dataset of a loose file in this process; raises BadInput if its name is another's."""
    for name, other in find_entries(entry.group).items():
        if name.casefold() == entry.name.casefold() and other.path != entry.path:
            raise BadInput(f"{entry.group}={entry.path}:{entry.name}: {other.path} has that name too: rename yours")
    _LOOSE[entry.group][entry.name] = entry


def spell_out_plugin_paths(option: str) -> str:
    """Return an option method=NAME or dataset=NAME as another process understands it: with a loose file's path."""
    group, equals, names = option.partition("=")
    loose = _LOOSE.get(group, {})
    paths = (f"{loose[name].provider}:{name}" if name in loose else name for name in names.split(","))
    return f"{group}{equals}{','.join(paths)}"


def find_conf_folders() -> dict[str, Path]:
    """Return the folders that hold method/ and dataset/, by package: this project's and those of plug-ins."""
    found = {"vprbench": _find_conf_folder("vprbench.conf"), **_find_plugins()}
    return {package: folder for package, folder in found.items() if folder is not None}


def list_broken_plugins() -> Iterator[tuple[str, str]]:
    """Yield each installed package whose folder of configurations is missing, with the reason."""
    for package, folder in _find_plugins().items():
        if folder is None:
            yield package, "its folder of configurations is not there: install it anew"


@cache
def _find_plugins() -> dict[str, Path | None]:
    """Return the folder of each package that declares one as an entry point; None if it is missing."""
    declared = sorted({point.value for point in entry_points(group="vprbench.conf")})
    return {value.removesuffix(".conf"): _find_conf_folder(value) for value in declared}


def _find_conf_folder(package: str) -> Path | None:
    """Return the folder of a package without importing it; None if there is none."""
    top, *rest = package.split(".")
    spec = importlib.util.find_spec(top)
    folders = [Path(part).joinpath(*rest) for part in (spec and spec.submodule_search_locations) or ()]
    return next(filter(Path.is_dir, folders), None)


@cache
def read(text: str) -> Any:
    """Return the content of a yaml; the same object for the same text."""
    return yaml.load(text, _Loader)


class _Loader(yaml.CSafeLoader):
    """Reads numbers as Hydra does: 1e-3 is one."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?[0-9][0-9_]*(\.[0-9_]*)?[eE][-+]?[0-9]+$"), list("-+0123456789")
)
