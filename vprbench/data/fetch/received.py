"""What a fetch leaves in a dataset's folder, and whether that is what its source states."""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path
from typing import Any

from vprbench.data.fetch.entries import Part
from vprbench.errors import BadInput
from vprbench.progress import report
from vprbench.storage.atomic import replace_text

RECORD = "fetched.json"  # in the dataset's folder
_CHUNK = 1 << 22  # bytes hashed at once


def count_files(folder: Path) -> int:
    """Return how many files are in a folder and those below it; hidden ones do not count."""
    return sum(path.is_file() and not path.name.startswith(".") for path in folder.rglob("*"))


def require_stated(part: Part, archive: Path) -> dict[str, Any]:
    """Return the size and SHA-256 of an archive; raises BadInput if the entry states others."""
    size_bytes, digest = archive.stat().st_size, hashlib.sha256()
    with archive.open("rb") as file:
        while chunk := file.read(_CHUNK):
            digest.update(chunk)
            report(f"checking {archive.name}", min(file.tell() / size_bytes, 1.0))
    for what, came, stated in (("bytes", size_bytes, part.size_bytes), ("SHA-256", digest.hexdigest(), part.sha256)):
        if stated is not None and came != stated:
            raise BadInput(f"{archive} has {what} {came}, stated is {stated}: remove it and run again")
    return {"bytes": size_bytes, "sha256": digest.hexdigest()}


def approve(part: Part, archive: Path, unpacked: Path) -> None:
    """Raise BadInput if an archive holds other folders than stated, or other files in them."""
    for name, held in part.holds.items():
        folder = unpacked / name
        if not folder.is_dir():
            raise BadInput(f"{archive} gave no folder {name}: it is another archive than expected, remove it")
        if held.sha256 is not None and (came := content_sha256(folder)) != held.sha256:
            raise BadInput(
                f"{archive} gave other files in {name} than expected (SHA-256 of their list {came}, stated is "
                f"{held.sha256}): remove it and run again"
            )


def content_sha256(folder: Path) -> str:
    """Return the SHA-256 of what `LC_ALL=C sha256sum *` prints in a folder."""
    digest = hashlib.sha256()
    for path in sorted(folder.iterdir(), key=lambda path: os.fsencode(path.name)):
        with path.open("rb") as file:
            line = f"{hashlib.file_digest(file, 'sha256').hexdigest()}  {path.name}\n"
        digest.update(line.encode())
    return digest.hexdigest()


def record(root: Path) -> dict[str, dict[str, Any]]:
    """Return what is recorded of the parts that were fetched, by name; none if the record is missing or nonsense."""
    try:
        parts = json.loads((root / RECORD).read_text(encoding="utf-8"))["parts"]
        return {name: dict(part) for name, part in parts.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}


def remember(root: Path, name: str, fetched: dict[str, Any]) -> None:
    """Record what came of one part, beside what is recorded of the others."""
    content = {"format": 1, "parts": {**record(root), name: fetched}}
    replace_text(root / RECORD, json.dumps(content, indent=1, ensure_ascii=False) + "\n")
