"""Datasets from the net: an entry of conf/fetch is downloaded, checked and unpacked, or says how a person gets it."""

from __future__ import annotations

import hashlib
import json
import logging
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, ClassVar

import yaml

from vprbench.errors import BadInput, MissingData
from vprbench.plugins import registry
from vprbench.plugins.options import option, parse_options
from vprbench.progress import show_progress
from vprbench.storage import download
from vprbench.storage.atomic import replace_text
from vprbench.storage.folders import data_folder
from vprbench.storage.hashes import compute_sha256
from vprbench.storage.unpack import UNFINISHED, DamagedArchive, Wanted, unpack
from vprbench.text import format_bytes, format_count, suggest_names

logger = logging.getLogger(__name__)

RECORD = "fetched.json"  # in the dataset's folder
ARCHIVES = "archives"  # the folder there for downloads
_LOCK = ".fetch.lock"
_OFFLINE = "VPRBENCH_OFFLINE"  # environment variable
_FORBID: Any = {"extra": "forbid"}

Check = Callable[[str, Path], Sequence[str]]  # of a dataset's name and folder: lines to print


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


@dataclass(frozen=True)
class Settings:
    """What to fetch, and where to."""

    parts: list[str] | None = option(None, "null: those that are usually wanted")
    root: str | None = option(None, "the dataset's folder; null: where runs look for it")
    keep_archives: bool = option(False, "true: archives stay beside the frames")


def downloads() -> dict[str, Download]:
    """Return what can be fetched, by name; of several with one name this project's own comes first."""
    found: dict[str, Download] = {}
    for folder in registry.find_conf_folders().values():
        for path in sorted((folder / "fetch").glob("*.yaml")):
            if path.stem not in found:
                found[path.stem] = read_entry(path)
    return dict(sorted(found.items()))


def read_entry(path: Path) -> Download:
    """Return the entry that a yaml holds; raises BadInput if it holds none."""
    text = path.read_text(encoding="utf-8")
    try:
        content = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise BadInput(f"{path} is no yaml ({' '.join(str(error).split())}): mend it") from error
    if not isinstance(content, dict):
        raise BadInput(f"{path} holds no entry: give licence, source, and parts or register")
    description = text.partition("\n")[0].lstrip("# ")
    entry = {"name": path.stem, "description": description, "folder": path.stem, **content}
    found: Download = registry.check_value(str(path), entry, Download)
    if not found.parts and found.register is None:
        raise BadInput(f"{path} has neither parts nor register: say what is downloaded, or what a person has to do")
    if unknown := [name for name in found.default or () if name not in found.parts]:
        raise BadInput(f"{path}: default names {unknown[0]}, which is none of its parts")
    return found


def fetch_command(arguments: Sequence[str], check: Check | None = None) -> int:
    """Fetch the dataset that the first of `arguments` names, or list all if there is none; returns the exit code.

    `check` returns lines about a dataset that was fetched. Raises BadInput for a name that cannot be fetched.
    """
    known = downloads()
    if not arguments:
        print(format_list(known.values()))
        return 0
    name, *options = arguments
    entry = known.get(name) or next((entry for entry in known.values() if name in entry.datasets), None)
    if entry is not None:
        return fetch(entry, parse_options(Settings, options), check)
    if name in registry.find_entries("dataset"):
        raise BadInput(f"fetch {name}: there is nothing to download, it is rendered or reads what you have")
    raise BadInput(f"fetch {name}: nothing of that name can be fetched; {suggest_names(name, known)}")


def format_list(known: Iterable[Download]) -> str:
    """Return the datasets that can be fetched as text: a few lines each."""
    lines = []
    for entry in known:
        by_hand = "a person has to ask for it" if entry.register else ""
        how = "; this command gets ".join(filter(None, [by_hand, _format_sizes(entry.parts)]))
        lines += [f"{entry.name}: {entry.description}", f"  {how}", f"  licence: {entry.licence}"]
    return "\n".join([*lines, "", "python -m vprbench fetch NAME gets one of them, or says what you have to do."])


def fetch(entry: Download, settings: Settings, check: Check | None = None, *, timeout_seconds: float = 30.0) -> int:
    """Get the missing parts of an entry; returns the exit code.

    The code is 2 if a person has to get the dataset and has not yet. An interrupted download is continued by the next
    call. Raises MissingData if no address gives a part, and BadInput if a part is not as the entry states or other
    files are in the way.
    """
    root = Path(settings.root).expanduser() if settings.root else data_folder(entry.folder)
    print(f"{entry.name}: {entry.description}\nLicence: {entry.licence}\nSource: {entry.source}\nFolder: {root}")
    for text in (entry.note, entry.register):
        if text:
            print(text.replace("{folder}", str(root)).rstrip())
    parts, is_new = entry.choose_parts(settings.parts), False
    try:
        missing = {name: part for name, part in parts.items() if not _is_there(name, part, root)}
        if missing:
            print(f"To download: {_format_sizes(missing)}.")
            with _lock_folder(root):
                for name, part in missing.items():
                    _fetch_part(entry, name, part, root, settings.keep_archives, timeout_seconds)
            is_new = True
    except MissingData as error:
        if not entry.register:
            raise
        print(error)
    if entry.register:
        ours = {RECORD, ARCHIVES, *(Path(folder).parts[0] for part in entry.parts.values() for folder in part.holds)}
        if not root.is_dir() or all(path.name.startswith(".") or path.name in ours for path in root.iterdir()):
            print(f"Nothing of that is in {root} yet. When it is, give this command again: it checks what is there.")
            return 2
        return 0 if _print_check(entry, root, check) else 2
    if is_new:
        _print_check(entry, root, check)
    else:
        print("Nothing is left to fetch.")
    return 0


def _print_check(entry: Download, root: Path, check: Check | None) -> bool:
    """Print the check of the first dataset that has all its frames; returns whether there is one."""
    if check is None or not entry.datasets:
        return True
    reasons = []
    for name in entry.datasets:
        try:
            lines = check(name, root)
        except MissingData as error:
            reasons.append(f"dataset={name} cannot run yet: {error}")
            continue
        print("\n".join([f"Checked as dataset={name}:", *lines]))
        return True
    print("\n".join(reasons))
    return False


def _is_there(name: str, part: Part, root: Path) -> bool:
    """Return whether a part is in its folders; raises BadInput if it is in some of them alone."""
    there = [folder for folder in part.holds if count_files(root / folder)]
    if there and len(there) < len(part.holds):
        others = " and ".join(str(root / folder) for folder in part.holds if folder not in there)
        raise BadInput(f"{root / there[0]} is there, but not {others}: move it away, then it is fetched with them")
    if there:
        fetched = _load_record(root).get(name, {}).get("fetched")
        print(f"{name} is there already, {f'fetched on {fetched}' if fetched else 'from where is not recorded'}.")
        _print_counts(part, root)
    return bool(there)


def _print_counts(part: Part, root: Path) -> None:
    for folder, held in part.holds.items():
        n_files = count_files(root / folder)
        but = "" if held.files in (None, n_files) else f", but {held.files} were expected"
        print(f"  {root / folder}: {format_count(n_files, 'file')}{but}")


@contextmanager
def _lock_folder(root: Path) -> Iterator[None]:
    """Keep other fetches out of a folder, and remove the files that a killed one had begun to unpack."""
    from filelock import FileLock, Timeout

    try:
        root.mkdir(parents=True, exist_ok=True)
        with FileLock(root / _LOCK, timeout=0):
            for folder in root.glob(f"{UNFINISHED}*"):
                shutil.rmtree(folder, ignore_errors=True)
            yield
    except Timeout as error:
        raise BadInput(f"another fetch is under way in {root}: wait until it has ended") from error
    except OSError as error:
        raise BadInput(f"{root} cannot be written ({error.strerror}): mend that, or give root=FOLDER") from error


def _fetch_part(
    entry: Download, name: str, part: Part, root: Path, keep_archives: bool, timeout_seconds: float
) -> None:
    """Download and unpack a part from the first of its addresses that gives it, and record that."""
    archive = root / ARCHIVES / part.file
    sources: list[str | None] = [*([None] if archive.exists() else []), *part.urls]
    for url in sources:
        try:
            with show_progress(f"fetch {name}"):
                if url is not None:
                    _download_archive(part, archive, url, timeout_seconds)
                got = _check_archive(part, archive)
                unpack(archive, root, part.unpack, lambda folder: _check_folders(part, folder))
            break
        except (MissingData, DamagedArchive) as error:
            if isinstance(error, DamagedArchive):
                archive.unlink()
            if url == sources[-1]:
                raise
            logger.warning("%s; the next address follows", error)
    today = datetime.now(UTC).date().isoformat()
    parts = {**_load_record(root), name: {"url": url, **got, "licence": entry.licence, "fetched": today}}
    replace_text(root / RECORD, json.dumps({"format": 1, "parts": parts}, indent=1, ensure_ascii=False) + "\n")
    if not keep_archives:
        archive.unlink()
        archive.with_name(f".{archive.name}.lock").unlink(missing_ok=True)
        if not any(archive.parent.iterdir()):
            archive.parent.rmdir()
    stated = "as stated" if part.sha256 else "none is stated: compare it with what others got"
    print(f"{name}: {got['bytes']} bytes from {url or archive}\n  SHA-256 {got['sha256']} ({stated})")
    _print_counts(part, root)


def _download_archive(part: Part, archive: Path, url: str, timeout_seconds: float) -> None:
    if os.environ.get(_OFFLINE, "0") not in ("", "0"):
        raise MissingData(f"{_OFFLINE} forbids downloads: get {url} elsewhere and store it as {archive}")
    download.fetch(
        url,
        archive,
        size_bytes=part.size_bytes,
        sha256=part.sha256,
        resume=part.sha256 is not None or not part.unpack.plain,  # archives have checksums of their own
        timeout_seconds=timeout_seconds,
    )


def _check_archive(part: Part, archive: Path) -> dict[str, Any]:
    """Return the size and SHA-256 of an archive; raises BadInput if the entry states others."""
    size_bytes, sha256 = archive.stat().st_size, compute_sha256(archive)
    for name, got, stated in (("bytes", size_bytes, part.size_bytes), ("SHA-256", sha256, part.sha256)):
        if stated is not None and got != stated:
            raise BadInput(f"{archive} has {name} {got}, stated is {stated}: remove it and run again")
    return {"bytes": size_bytes, "sha256": sha256}


def _check_folders(part: Part, unpacked: Path) -> None:
    """Raise BadInput if a folder that a part should hold is not among what was unpacked, or holds other files."""
    for name, held in part.holds.items():
        folder = unpacked / name
        if not folder.is_dir():
            raise BadInput(f"gave no folder {name}: it is another archive than expected, remove it")
        if held.sha256 is not None and (got := hash_content(folder)) != held.sha256:
            raise BadInput(
                f"gave other files in {name} than expected (SHA-256 of their list {got}, stated is {held.sha256}): "
                "remove it and run again"
            )


def count_files(folder: Path) -> int:
    """Return how many files are in a folder and those below it; hidden ones do not count."""
    return sum(path.is_file() and not path.name.startswith(".") for path in folder.rglob("*"))


def hash_content(folder: Path) -> str:
    """Return the SHA-256 of the lines that `LC_ALL=C sha256sum *` prints in a folder."""
    paths = sorted(folder.iterdir(), key=lambda path: os.fsencode(path.name))
    return hashlib.sha256("".join(f"{compute_sha256(path)}  {path.name}\n" for path in paths).encode()).hexdigest()


def _load_record(root: Path) -> dict[str, dict[str, Any]]:
    """Return the record of the parts that were fetched, by name; empty if it is missing or damaged."""
    try:
        parts = json.loads((root / RECORD).read_text(encoding="utf-8"))["parts"]
        return {name: dict(part) for name, part in parts.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}


def _format_sizes(parts: Mapping[str, Part]) -> str:
    known = {name: part.size_bytes or part.about_bytes for name, part in parts.items()}
    if len(known) > 1 and not any(known.values()):
        return f"{', '.join(known)} (sizes not stated)"
    return ", ".join(f"{name} ({format_bytes(size) if size else 'size not stated'})" for name, size in known.items())
