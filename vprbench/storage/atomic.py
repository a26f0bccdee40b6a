"""Files and folders replaced as a whole: whoever reads meanwhile finds the old one or the new one."""

from __future__ import annotations

import errno
import shutil
import tempfile
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

PARTIAL = ".partial-"  # begins the names of unfinished files and folders, which no reader opens
_REPLACED = ".replaced-"  # begins the names of folders that make way for another one
_FORGOTTEN_SECONDS = 86400.0
_ATTEMPTS = 100  # to replace a folder that other processes replace too


def unfinished(folder: Path, ending: str = "") -> Path:
    """Return a name in a folder that no other process has, for a file or a folder that is being written."""
    return folder / f"{PARTIAL}{uuid.uuid4().hex}{ending}"


def remove_leftovers(folder: Path, ending: str = "") -> None:
    """Remove unfinished files and folders whose names end so and that nobody has written to for a day."""
    with suppress(OSError):
        for path in folder.iterdir():
            if path.name.startswith(PARTIAL) and path.name.endswith(ending):
                with suppress(OSError):  # its writer has just finished, or the system refuses
                    _remove_if_forgotten(path)


@contextmanager
def scratch() -> Iterator[Path]:
    """Yield a temporary folder, removed in the end."""
    with tempfile.TemporaryDirectory(prefix="vprbench-", ignore_cleanup_errors=True) as folder:
        yield Path(folder)


def replace_text(path: Path, content: str) -> None:
    """Write a text file so that a reader sees the old or the new one, never a part."""
    replace_bytes(path, content.encode())


def replace_bytes(path: Path, content: bytes) -> None:
    """Write a file so that a reader sees the old or the new one, never a part."""
    partial = unfinished(path.parent)
    try:
        partial.write_bytes(content)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def replace_folder(partial: Path, folder: Path) -> None:
    """Rename a complete folder to its final name beside it; of several writers of one name the last one stays.

    An earlier folder is renamed first and removed last. In between `folder_versions` finds it, so that a process that
    is killed at any moment loses neither. Raises OSError if the system refuses.
    """
    remove_replaced(folder.parent)  # of killed processes, or a reader might take one for the last
    for _ in range(_ATTEMPTS):
        try:
            partial.rename(folder)
        except OSError as error:
            if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                raise
            with suppress(FileNotFoundError):  # another process has just renamed it
                folder.rename(folder.with_name(f"{_REPLACED}{folder.name}-{uuid.uuid4().hex}"))
        else:
            break
    else:
        raise OSError(f"{folder} is being replaced by others all the time")
    remove_replaced(folder.parent)


def folder_versions(folder: Path) -> list[Path]:
    """Return where a folder lies: under its name, else under the names that it had to make way under."""
    if folder.exists():
        return [folder]
    replaced = [path for path in _find_replaced_folders(folder.parent) if _final_folder(path) == folder]
    return [folder] if folder.exists() else replaced  # the new one may have come while the old ones were listed


def final_folders(parent: Path) -> list[Path]:
    """Return the final names of all folders in a folder, sorted; names that begin with a dot are unfinished.

    Raises OSError if the folder cannot be listed.
    """
    found = {path for path in parent.iterdir() if not path.name.startswith(".") and path.is_dir()}
    return sorted(found | {_final_folder(path) for path in _find_replaced_folders(parent)})


def remove_replaced(parent: Path) -> None:
    """Remove replaced folders whose replacement is there."""
    for path in _find_replaced_folders(parent):
        if _final_folder(path).exists():
            shutil.rmtree(path, ignore_errors=True)


def _find_replaced_folders(parent: Path) -> list[Path]:
    with suppress(OSError):
        return [path for path in parent.iterdir() if path.name.startswith(_REPLACED)]
    return []


def _final_folder(replaced: Path) -> Path:
    return replaced.with_name(replaced.name.removeprefix(_REPLACED).rpartition("-")[0])


def _remove_if_forgotten(path: Path) -> None:
    written = max(part.stat().st_mtime for part in (path, *path.rglob("*")))
    if time.time() - written < _FORGOTTEN_SECONDS:
        return
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink()
