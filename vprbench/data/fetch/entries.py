"""The datasets that can be fetched, a yaml of conf/fetch for each, and the checks of files that came."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import yaml

from vprbench.errors import BadInput
from vprbench.plugins import registry
from vprbench.storage.atomic import replace_text
from vprbench.storage.unpack import Wanted
from vprbench.text import suggest_names

_FORBID: Any = {"extra": "forbid"}


@dataclass(frozen=True)
class FetchedFile:
    """What a folder holds once it is fetched."""

    __pydantic_config__: ClassVar[Any] = _FORBID

    files: int | None = None  # None: the source states no number
    sha256: str | None = None  # of the lines that `LC_ALL=C sha256sum *` prints in it


@dataclass(frozen=True)
class Part:
    """One file to download, and what becomes of it."""

    __pydantic_config__: ClassVar[Any] = _FORBID

    file: str  # its name among the archives
    urls: tuple[str, ...]  # tried in turn
    unpack: Wanted
    holds: Mapping[str, FetchedFile]  # by folder below the dataset's
    about_bytes: int | None = None  # if the source states its size roughly
    size_bytes: int | None = None  # if it states its size exactly
    sha256: str | None = None


@dataclass(frozen=True)
class Download:
    """One entry: a dataset that can be fetched, or what a person has to do to get it."""

    __pydantic_config__: ClassVar[Any] = _FORBID

    name: str
    description: str
    licence: str
    source: str  # where a person reads about it
    datasets: tuple[str, ...]  # that read it, in conf/dataset; the first is checked after the download
    folder: str  # below the folder of all data
    parts: Mapping[str, Part] = field(default_factory=dict)
    default: tuple[str, ...] | None = None  # the parts that are fetched unless others are named; None: all
    register: str | None = None  # what a person has to do if no program may download all of it
    note: str | None = None

    def choose_parts(self, names: list[str] | None) -> dict[str, Part]:
        """Return the parts of these names, or those that are usually wanted; raises BadInput for an unknown one."""
        given = list(self.default or self.parts) if names is None else names
        for name in given:
            if name not in self.parts:
                advice = suggest_names(name, self.parts) if self.parts else "leave parts out"
                raise BadInput(f"parts: {self.name} has no {name}: {advice}")
        return {name: self.parts[name] for name in given}


def downloads() -> dict[str, Download]:
    """Return what can be fetched, by name; of several with one name this project's own comes first."""
    found: dict[str, Download] = {}
    for folder in registry.conf_folders().values():
        for path in sorted((folder / "fetch").glob("*.yaml")):
            if path.stem not in found:
                found[path.stem] = read(path)
    return dict(sorted(found.items()))


def read(path: Path) -> Download:
    """Return the entry that a yaml holds; raises BadInput if it holds none."""
    text = path.read_text(encoding="utf-8")
    first = text.partition("\n")[0]
    try:
        content = yaml.safe_load(text)
    except yaml.YAMLError as error:
        reason = " ".join(str(error).split())
        raise BadInput(f"{path} is no yaml ({reason}): mend it") from error
    if not isinstance(content, dict):
        raise BadInput(f"{path} holds no entry: give licence, source, and parts or register")
    entry = {"name": path.stem, "description": first.lstrip("# "), "folder": path.stem, **content}
    download: Download = registry.check_value(str(path), entry, Download)
    if not download.parts and download.register is None:
        raise BadInput(f"{path} has neither parts nor register: say what is downloaded, or what a person has to do")
    if unknown := [name for name in download.default or () if name not in download.parts]:
        raise BadInput(f"{path}: default names {unknown[0]}, which is none of its parts")
    return download


RECORD = "fetched.json"  # in the dataset's folder


def count_files(folder: Path) -> int:
    """Return how many files are in a folder and those below it; hidden ones do not count."""
    return sum(path.is_file() and not path.name.startswith(".") for path in folder.rglob("*"))


def check_archive(part: Part, archive: Path) -> dict[str, Any]:
    """Return the size and SHA-256 of an archive; raises BadInput if the entry states others."""
    size_bytes = archive.stat().st_size
    with archive.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    for name, came, stated in (("bytes", size_bytes, part.size_bytes), ("SHA-256", sha256, part.sha256)):
        if stated is not None and came != stated:
            raise BadInput(f"{archive} has {name} {came}, stated is {stated}: remove it and run again")
    return {"bytes": size_bytes, "sha256": sha256}


def check_folders(part: Part, unpacked: Path) -> None:
    """Raise BadInput if a folder that a part should hold is not among what was unpacked, or holds other files."""
    for name, held in part.holds.items():
        folder = unpacked / name
        if not folder.is_dir():
            raise BadInput(f"gave no folder {name}: it is another archive than expected, remove it")
        if held.sha256 is not None and (came := content_sha256(folder)) != held.sha256:
            raise BadInput(
                f"gave other files in {name} than expected (SHA-256 of their list {came}, stated is {held.sha256}): "
                "remove it and run again"
            )


def content_sha256(folder: Path) -> str:
    """Return the SHA-256 of the lines that `LC_ALL=C sha256sum *` prints in a folder."""
    digest = hashlib.sha256()
    for path in sorted(folder.iterdir(), key=lambda path: os.fsencode(path.name)):
        with path.open("rb") as file:
            digest.update(f"{hashlib.file_digest(file, 'sha256').hexdigest()}  {path.name}\n".encode())
    return digest.hexdigest()


def load_record(root: Path) -> dict[str, dict[str, Any]]:
    """Return the record of the parts that were fetched, by name; empty if it is missing or damaged."""
    try:
        parts = json.loads((root / RECORD).read_text(encoding="utf-8"))["parts"]
        return {name: dict(part) for name, part in parts.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}


def add_to_record(root: Path, name: str, fetched: dict[str, Any]) -> None:
    """Write one part into the record, beside the others."""
    content = {"format": 1, "parts": {**load_record(root), name: fetched}}
    replace_text(root / RECORD, json.dumps(content, indent=1, ensure_ascii=False) + "\n")
