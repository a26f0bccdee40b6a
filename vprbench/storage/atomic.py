"""Files and folders replaced as a whole: whoever reads meanwhile finds the old one or the new one."""

from __future__ import annotations

import ctypes
import errno
import os
import shutil
import tempfile
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from vprbench.storage import owner

PARTIAL = ".partial-"  # how the names of what is being written begin: no reader looks at them
REPLACED = "-replaced-"  # within such a name: a whole folder whose replacement was about to arrive
FORGOTTEN_SECONDS = 86400.0  # nobody needs so long from one byte of a file to the next

_HERE, _EXCHANGE = -100, 2  # AT_FDCWD and RENAME_EXCHANGE of Linux


def unfinished(folder: Path, ending: str = "") -> Path:
    """Return a name in a folder that nobody else has, for what is being written there."""
    return folder / f"{PARTIAL}{owner.mark()}-{uuid.uuid4().hex}{ending}"


def leftovers(folder: Path, ending: str = "") -> Iterator[Path]:
    """Yield what was begun to be written in a folder by a process of this host that is dead, or not touched for a day.

    Of processes in other containers or on other machines age alone tells, by the clock of the disk. Raises OSError for
    the folder.
    """
    found = [
        path
        for path in folder.iterdir()
        if path.name.startswith(PARTIAL) and path.name.endswith(ending) and REPLACED not in path.name
    ]
    if not found:
        return
    probe = unfinished(folder)
    probe.touch()
    now = probe.stat().st_mtime
    probe.unlink()
    for path in found:
        with suppress(OSError):  # its writer has just finished
            touched = max(part.stat().st_mtime for part in (path, *path.rglob("*")))
            if owner.is_dead(path.name.removeprefix(PARTIAL)) or now - touched > FORGOTTEN_SECONDS:
                yield path


@contextmanager
def scratch() -> Iterator[Path]:
    """Yield a temporary folder, removed in the end, and remove the folders that killed processes left behind."""
    ending = "-vprbench"
    remove_leftovers(Path(tempfile.gettempdir()), ending)
    begins = f"{PARTIAL}{owner.mark()}-"
    with tempfile.TemporaryDirectory(ending, begins, ignore_cleanup_errors=True) as folder:
        yield Path(folder)


def remove_leftovers(folder: Path, ending: str = "") -> None:
    """Remove what killed processes left unfinished in a folder, under names that end so; what refuses stays."""
    with suppress(OSError):
        for path in leftovers(folder, ending):
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                with suppress(OSError):
                    path.unlink()


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


def move_folder(partial: Path, folder: Path) -> None:
    """Rename a complete folder to its final name; of several writers of one name the last one stays.

    If the system can exchange two folders, the replaced folder is left under the name `partial` for the caller to
    remove, and a reader finds the old run or the new run at any time, else for a moment none. If the final folder is
    on another disk, by way of a link, it is copied there first; `partial` then stays for the caller to remove.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    aside: list[Path] = []
    for _ in range(100):
        try:
            partial.rename(folder)
        except OSError as error:
            if error.errno == errno.EXDEV:
                _move_copy(partial, folder)
                return
            if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                raise
            try:
                if exchange(partial, folder):
                    break
                replaced = partial.with_name(f"{partial.name}{REPLACED}{uuid.uuid4().hex[:8]}")
                folder.rename(replaced)
            except FileNotFoundError:
                continue  # another process has just replaced it
            aside.append(replaced)
        else:
            break
    else:
        raise OSError(f"{folder} is being replaced by others all the time")
    for replaced in aside:
        shutil.rmtree(replaced, ignore_errors=True)


def _move_copy(partial: Path, folder: Path) -> None:
    """Copy a folder to the disk of its final name and rename it there."""
    there = unfinished(folder.parent)
    try:
        shutil.copytree(partial, there)
        move_folder(there, folder)
    finally:
        shutil.rmtree(there, ignore_errors=True)


def exchange(first: Path, second: Path) -> bool:
    """Swap the names of two folders in one step; returns False if the system has no such step."""
    try:
        exchange = ctypes.CDLL(None, use_errno=True).renameat2
    except (OSError, AttributeError, TypeError):  # no Linux, or an old one
        return False
    if exchange(_HERE, os.fsencode(first), _HERE, os.fsencode(second), _EXCHANGE) == 0:
        return True
    if ctypes.get_errno() == errno.ENOENT:
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(second))
    return False
