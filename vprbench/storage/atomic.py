"""Files replaced as a whole: a reader finds the old one or the new one, never a part."""

from __future__ import annotations

import shutil
import time
import uuid
from contextlib import suppress
from pathlib import Path

PARTIAL = ".partial-"  # begins the names of unfinished files and folders, which no reader opens
_FORGOTTEN_SECONDS = 86400.0


def name_unfinished(folder: Path) -> Path:
    """Return a name in a folder that no other process has, for a file or a folder that is being written."""
    return folder / f"{PARTIAL}{uuid.uuid4().hex}"


def remove_leftovers(folder: Path) -> None:
    """Remove unfinished files and folders that nobody has written to for a day."""
    for path in folder.glob(f"{PARTIAL}*"):
        with suppress(OSError):  # its writer has just finished, or the system refuses
            written = max(part.stat().st_mtime for part in (path, *path.rglob("*")))
            if time.time() - written > _FORGOTTEN_SECONDS:
                shutil.rmtree(path) if path.is_dir() else path.unlink()


def replace_text(path: Path, content: str) -> None:
    """Replace a text file, in UTF-8; raises OSError if the disk refuses, which leaves the old file."""
    replace_bytes(path, content.encode())


def replace_bytes(path: Path, content: bytes) -> None:
    """Replace a file; raises OSError if the disk refuses, which leaves the old file."""
    partial = name_unfinished(path.parent)
    try:
        partial.write_bytes(content)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
