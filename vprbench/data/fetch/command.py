"""The command that gets a dataset: downloads, checks and unpacks it, or tells a person how to get it."""

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
    add_to_record,
    check_archive,
    check_folders,
    count_files,
    downloads,
    load_record,
)
from vprbench.errors import BadInput, MissingData
from vprbench.plugins import registry
from vprbench.plugins.options import option, parse_options
from vprbench.progress import progress_shown
from vprbench.storage import download
from vprbench.storage.folders import data_folder
from vprbench.storage.unpack import UNFINISHED, DamagedArchive, unpack
from vprbench.text import format_bytes, suggest_names

logger = logging.getLogger(__name__)

ARCHIVES = "archives"  # the folder there for downloads
_LOCK = ".fetch.lock"
_OFFLINE = "VPRBENCH_OFFLINE"  # environment variable

Check = Callable[[str, Path], Sequence[str]]  # of a dataset's name and folder: lines to print


@dataclass(frozen=True)
class Settings:
    """What to fetch, and where to."""

    parts: list[str] | None = option(None, "null: those that are usually wanted")
    root: str | None = option(None, "the dataset's folder; null: where runs look for it")
    keep_archives: bool = option(False, "true: archives stay beside the frames")


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
        return fetch(entry, parse_options(Settings, options, {}), check)
    if name in registry.entries("dataset"):
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
    try:
        is_new = _fetch_missing(entry, root, settings, timeout_seconds)
    except MissingData as error:
        if not entry.register:
            raise
        is_new = False
        print(error)
    if entry.register:
        if not _has_files_by_hand(entry, root):
            print(f"Nothing of that is in {root} yet. When it is, give this command again: it checks what is there.")
            return 2
        return 0 if _print_check(entry, root, check) else 2
    if is_new:
        _print_check(entry, root, check)
    else:
        print("Nothing is left to fetch.")
    return 0


def _has_files_by_hand(entry: Download, root: Path) -> bool:
    """Tell whether a person has put anything into a dataset's folder."""
    ours = {RECORD, ARCHIVES, *(Path(folder).parts[0] for part in entry.parts.values() for folder in part.holds)}
    return root.is_dir() and any(not path.name.startswith(".") and path.name not in ours for path in root.iterdir())


def _fetch_missing(entry: Download, root: Path, settings: Settings, timeout_seconds: float) -> bool:
    """Fetch the parts of an entry that are not there; returns whether there was any."""
    parts = entry.choose_parts(settings.parts)
    missing = {name: part for name, part in parts.items() if not _is_there(name, part, root)}
    if not missing:
        return False
    print(f"To download: {_format_sizes(missing)}.")
    with _lock_folder(root):
        for name, part in missing.items():
            _fetch_part(entry, name, part, root, settings.keep_archives, timeout_seconds)
    return True


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
    if not there:
        return False
    fetched = load_record(root).get(name, {}).get("fetched")
    print(f"{name} is there already, {f'fetched on {fetched}' if fetched else 'from where is not recorded'}.")
    _print_counts(part, root)
    return True


def _print_counts(part: Part, root: Path) -> None:
    for folder, held in part.holds.items():
        n_files = count_files(root / folder)
        but = "" if held.files in (None, n_files) else f", but {held.files} were expected"
        print(f"  {root / folder}: {n_files} file{'' if n_files == 1 else 's'}{but}")


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
            with progress_shown(f"fetch {name}"):
                if url is not None:
                    _download(part, archive, url, timeout_seconds)
                came = check_archive(part, archive)
                unpack(archive, root, part.unpack, lambda folder: check_folders(part, folder))
            break
        except (MissingData, DamagedArchive) as error:
            if isinstance(error, DamagedArchive):
                archive.unlink()
            if url == sources[-1]:
                raise
            logger.warning("%s; the next address follows", error)
    today = datetime.now(UTC).date().isoformat()
    add_to_record(root, name, {"url": url, **came, "licence": entry.licence, "fetched": today})
    if not keep_archives:
        archive.unlink()
        archive.with_name(f".{archive.name}.lock").unlink(missing_ok=True)
        if not any(archive.parent.iterdir()):
            archive.parent.rmdir()
    stated = "as stated" if part.sha256 else "none is stated: compare it with what others got"
    print(f"{name}: {came['bytes']} bytes from {url or archive}\n  SHA-256 {came['sha256']} ({stated})")
    _print_counts(part, root)


def _download(part: Part, archive: Path, url: str, timeout_seconds: float) -> None:
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


def _format_sizes(parts: Mapping[str, Part]) -> str:
    known = {name: part.size_bytes or part.about_bytes for name, part in parts.items()}
    if len(known) > 1 and not any(known.values()):
        return f"{', '.join(known)} (sizes not stated)"
    return ", ".join(f"{name} ({_format_size(n_bytes)})" for name, n_bytes in known.items())


def _format_size(n_bytes: int | None) -> str:
    return "size not stated" if n_bytes is None else format_bytes(n_bytes)
