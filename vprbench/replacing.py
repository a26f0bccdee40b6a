"""Files and folders replaced as a whole: whoever reads meanwhile finds the old one or the new one."""

from __future__ import annotations

import ctypes
import errno
import os
import shutil
import tempfile
import uuid
from pathlib import Path

from vprbench.interface import BadInput

_HERE, _EXCHANGE = -100, 2  # AT_FDCWD and RENAME_EXCHANGE of Linux


def insist_on_writing(folder: Path) -> None:
    """Raise BadInput for a folder that nothing can be written to, as a link to a disk that is not there; none is made.

    A folder that is missing will be made, if the one above it takes it.
    """
    if not os.path.lexists(folder):
        return
    try:
        tempfile.TemporaryDirectory(prefix=".partial-", dir=folder).cleanup()
    except OSError as error:
        raise BadInput(
            f"{folder} cannot be written ({error.strerror or error}), where the run would be stored: mend that, or "
            "choose another folder with results=..."
        ) from error


def replace_text(path: Path, content: str) -> None:
    """Write a text file so that a reader sees the old or the new one, never a part."""
    replace_bytes(path, content.encode())


def replace_bytes(path: Path, content: bytes) -> None:
    """Write a file so that a reader sees the old or the new one, never a part."""
    partial = path.with_name(f".partial-{path.name}-{uuid.uuid4().hex[:8]}")
    try:
        partial.write_bytes(content)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def move_folder(partial: Path, folder: Path) -> None:
    """Rename a complete folder to its final name; of several writers of one name the last one stays.

    What was replaced is left to be removed under the name `partial`, where the system can exchange two folders. There a
    reader finds the old run or the new one at any time, elsewhere for a moment none. Where the final folder is on
    another disk, by way of a link, it is copied there first; `partial` then stays for the caller to remove.
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
                replaced = partial.with_name(f"{partial.name}-replaced-{uuid.uuid4().hex[:8]}")
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
    there = folder.with_name(f".partial-{uuid.uuid4().hex}")
    try:
        shutil.copytree(partial, there)
        move_folder(there, folder)
    finally:
        shutil.rmtree(there, ignore_errors=True)


def exchange(first: Path, second: Path) -> bool:
    """Swap the names of two folders in one step; returns False where the system has no such step."""
    try:
        exchange = ctypes.CDLL(None, use_errno=True).renameat2
    except (OSError, AttributeError, TypeError):  # no Linux, or an old one
        return False
    if exchange(_HERE, os.fsencode(first), _HERE, os.fsencode(second), _EXCHANGE) == 0:
        return True
    if ctypes.get_errno() == errno.ENOENT:
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(second))
    return False
