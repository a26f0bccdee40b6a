"""The command that gets a dataset: downloads, checks and unpacks it, or says what a person has to do."""

from __future__ import annotations

import logging
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from vprbench.data.fetch.entries import (
    RECORD,
    Download,
    Part,
    approve,
    count_files,
    downloads,
    record,
    remember,
    require_stated,
)
from vprbench.errors import BadInput, NotThere
from vprbench.plugins import registry
from vprbench.plugins.options import chosen, option
from vprbench.progress import progress_shown
from vprbench.storage import download
from vprbench.storage.folders import data_folder
from vprbench.storage.unpack import UNFINISHED, DamagedArchive, unpack
from vprbench.text import format_bytes

logger = logging.getLogger(__name__)

ARCHIVES = "archives"  # the folder there for what was downloaded
_LOCK = ".fetch.lock"
_OFFLINE = "VPRBENCH_OFFLINE"  # environment variable

Check = Callable[[str, Path], Sequence[str]]  # of a dataset's name and folder: lines to print


@dataclass(frozen=True)
class Settings:
    """What to fetch, and where to."""

    parts: list[str] | None = option(None, "null: those that are usually wanted")
    root: str | None = option(None, "the dataset's folder; null: where runs look for it")
    keep_archives: bool = option(False, "true: archives stay beside the frames")


@dataclass(frozen=True)
class _Place:
    """Where parts go, and how patiently they are downloaded."""

    root: Path
    keep_archives: bool
    timeout_seconds: float
    pause_seconds: float

    def archive(self, part: Part) -> Path:
        return self.root / ARCHIVES / part.file


def fetch_command(arguments: Sequence[str], check: Check | None = None) -> int:
    """Fetch the dataset that the first of `arguments` names, or list all if there is none; returns the exit code.

    `check` returns lines about a dataset that was fetched. Raises BadInput for a name that cannot be fetched.
    """
    known = downloads()
    if not arguments:
        print(listing(known.values()))
        return 0
    name, *options = arguments
    entry = known.get(name) or next((entry for entry in known.values() if name in entry.datasets), None)
    if entry is not None:
        return fetch(entry, chosen(Settings, options, {}), check)
    if name in registry.entries("dataset"):
        raise BadInput(f"fetch {name}: there is nothing to download, it is rendered or reads what you have")
    raise BadInput(f"fetch {name}: nothing of that name can be fetched; {registry.near(name, known)}")


def listing(known: Iterable[Download]) -> str:
    """Return what can be fetched, as text: a few lines each."""
    lines = []
    for entry in known:
        by_hand = "a person has to ask for it" if entry.register else ""
        how = "; this command gets ".join(filter(None, [by_hand, _sizes(entry.parts)]))
        lines += [f"{entry.name}: {entry.description}", f"  {how}", f"  licence: {entry.licence}"]
    return "\n".join([*lines, "", "python -m vprbench fetch NAME gets one of them, or says what you have to do."])


def fetch(
    entry: Download,
    settings: Settings,
    check: Check | None = None,
    *,
    timeout_seconds: float = 30.0,
    pause_seconds: float = 1.0,
) -> int:
    """Get what an entry describes, as far as it is not there; returns the exit code.

    The code is 2 if a person has to get the dataset and has not yet. The downloads of an interrupted fetch are kept and
    continued. Raises NotThere if no address gives a part, and BadInput if a part is not what the entry states, the disk
    is too small, or other files are in the way.
    """
    root = Path(settings.root).expanduser() if settings.root else data_folder(entry.folder)
    print(f"{entry.name}: {entry.description}\nLicence: {entry.licence}\nSource: {entry.source}\nFolder: {root}")
    for text in (entry.note, entry.register):
        if text:
            print(text.replace("{folder}", str(root)).rstrip())
    place = _Place(root, settings.keep_archives, timeout_seconds, pause_seconds)
    if not entry.register:
        if _bring_missing(entry, place, settings.parts):
            _checked(entry, root, check)
        else:
            print("Nothing is left to fetch.")
        return 0
    try:
        _bring_missing(entry, place, settings.parts)
    except NotThere as error:
        print(error)
    if not _by_hand(entry, root):
        print(f"Nothing of that is in {root} yet. When it is, give this command again: it checks what is there.")
        return 2
    return 0 if _checked(entry, root, check) else 2


def _by_hand(entry: Download, root: Path) -> bool:
    """Return whether a person has put anything into a dataset's folder."""
    ours = {RECORD, ARCHIVES, *(Path(folder).parts[0] for part in entry.parts.values() for folder in part.holds)}
    return root.is_dir() and any(not path.name.startswith(".") and path.name not in ours for path in root.iterdir())


def _bring_missing(entry: Download, place: _Place, names: list[str] | None) -> bool:
    """Bring the parts of an entry that are not there; returns whether any was brought."""
    parts = entry.chosen(names)
    missing = {name: part for name, part in parts.items() if not _is_there(name, part, place.root)}
    if not missing:
        return False
    _require_space(missing, place)
    with _alone(place.root):
        for name, part in missing.items():
            _bring(entry, name, part, place)
    return True


def _checked(entry: Download, root: Path, check: Check | None) -> bool:
    """Print what is found in the first dataset that has all its frames; returns whether there is one."""
    if check is None or not entry.datasets:
        return True
    reasons = []
    for name in entry.datasets:
        try:
            lines = check(name, root)
        except NotThere as error:
            reasons.append(f"dataset={name} cannot run yet: {error}")
            continue
        print("\n".join([f"Checked as dataset={name}:", *lines]))
        return True
    print("\n".join(reasons))
    return False


def _is_there(name: str, part: Part, root: Path) -> bool:
    """Return whether a part is in its folders; raises BadInput if it is in some alone, or a folder is an empty link."""
    counts = {folder: count_files(root / folder) for folder in part.holds}
    links = [root / folder for folder, n_files in counts.items() if not n_files and (root / folder).is_symlink()]
    if links:
        raise BadInput(f"{links[0]} is a link, and nothing is unpacked into one: remove it, or make {root} the link")
    if not all(counts.values()):
        if some := [folder for folder, n_files in counts.items() if n_files]:
            others = " and ".join(str(root / folder) for folder in counts if folder not in some)
            raise BadInput(f"{root / some[0]} is there, but not {others}: move it away, then it is fetched with them")
        return False
    fetched = record(root).get(name, {}).get("fetched")
    print(f"{name} is there already, {f'fetched on {fetched}' if fetched else 'from where is not recorded'}.")
    _print_counts(part, root)
    return True


def _print_counts(part: Part, root: Path) -> None:
    for folder, held in part.holds.items():
        n_files = count_files(root / folder)
        but = "" if held.files in (None, n_files) else f", but {held.files} were expected"
        print(f"  {root / folder}: {n_files} file{'' if n_files == 1 else 's'}{but}")


def _sizes(parts: Mapping[str, Part]) -> str:
    known = {name: part.size_bytes or part.about_bytes for name, part in parts.items()}
    if len(known) > 1 and not any(known.values()):
        return f"{', '.join(known)} (sizes not stated)"
    return ", ".join(f"{name} ({_size(n_bytes)})" for name, n_bytes in known.items())


def _require_space(missing: Mapping[str, Part], place: _Place) -> None:
    """Raise BadInput if the disk cannot hold the downloads and unpacked files, whose sizes the entry states."""
    downloads_bytes = [
        max((part.size_bytes or part.about_bytes or 0) - download.kept_bytes(place.archive(part)), 0)
        for part in missing.values()
    ]
    unpacked = sum(part.unpack.unpacked_bytes for part in missing.values())
    needed = unpacked + (sum(downloads_bytes) if place.keep_archives else max(downloads_bytes))
    print(f"To download: {_sizes(missing)}; with what is unpacked at most {_size(needed)}.")
    existing = next(folder for folder in [place.root, *place.root.absolute().parents] if folder.exists())
    free = shutil.disk_usage(existing).free
    if free < needed:
        advice = "free some, fetch fewer parts, or give root=FOLDER on another disk"
        raise BadInput(f"{place.root} has {_size(free)} free, but {_size(needed)} may be needed: {advice}")


@contextmanager
def _alone(root: Path) -> Iterator[None]:
    """Keep other fetches out of a folder, and remove what a killed one had begun to unpack."""
    from filelock import FileLock, Timeout

    lock = FileLock(root / _LOCK)
    try:
        root.mkdir(parents=True, exist_ok=True)
        lock.acquire(timeout=0)
    except Timeout as error:
        raise BadInput(f"another fetch is under way in {root}: wait until it has ended") from error
    except OSError as error:
        raise BadInput(f"{root} cannot be written ({error.strerror}): mend that, or give root=FOLDER") from error
    try:
        for folder in root.glob(f"{UNFINISHED}*"):
            shutil.rmtree(folder, ignore_errors=True)
        yield
    finally:
        lock.release()


def _bring(entry: Download, name: str, part: Part, place: _Place) -> None:
    """Download and unpack a part from the first of its addresses that gives it, and record that."""
    archive = place.archive(part)
    sources: list[str | None] = [*([None] if archive.exists() else []), *part.urls]
    for url in sources:
        try:
            with progress_shown(f"fetch {name}"):
                _download(part, archive, url, place)
                came = require_stated(part, archive)
                unpack(archive, place.root, part.unpack, lambda folder: approve(part, archive, folder))
        except (NotThere, DamagedArchive) as error:
            deleted = ""
            if isinstance(error, DamagedArchive):
                archive.unlink()
                deleted = " (it was deleted{})"
            if url == sources[-1]:
                raise type(error)(f"{error}{deleted.format(': give the same command again')}") from error
            logger.warning("%s%s; the next address follows", _short(url, error), deleted.format(""))
            continue
        break
    today = datetime.now(UTC).date().isoformat()
    remember(place.root, name, {"url": url, **came, "licence": entry.licence, "fetched": today})
    if not place.keep_archives:
        _remove(archive)
    stated = "as stated" if part.sha256 else "none is stated: compare it with what others got"
    print(f"{name}: {came['bytes']} bytes from {url or archive}\n  SHA-256 {came['sha256']} ({stated})")
    _print_counts(part, place.root)


def _download(part: Part, archive: Path, url: str | None, place: _Place) -> None:
    if url is None:
        return
    if os.environ.get(_OFFLINE, "0") not in ("", "0"):
        raise NotThere(f"{_OFFLINE} forbids downloads: get {url} elsewhere and store it as {archive}")
    download.fetch(
        url,
        archive,
        size_bytes=part.size_bytes,
        sha256=part.sha256,
        timeout_seconds=place.timeout_seconds,
        pause_seconds=place.pause_seconds,
    )


def _remove(archive: Path) -> None:
    """Remove an archive, and its folder if nothing else is in it."""
    archive.unlink()
    archive.with_name(f".{archive.name}.lock").unlink(missing_ok=True)
    if not any(archive.parent.iterdir()):
        archive.parent.rmdir()


def _short(url: str | None, error: BadInput) -> str:
    """Return why an address failed, without what a person could do instead."""
    return f"{url} {error.__cause__}" if isinstance(error, NotThere) and url and error.__cause__ else str(error)


def _size(n_bytes: int | None) -> str:
    """Return a number of bytes for a person to read."""
    return "size not stated" if n_bytes is None else format_bytes(n_bytes)
