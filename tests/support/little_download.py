"""A dataset of two seasons to fetch, and what is looked at afterwards."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
from archive_files import tarred, zipped

from vprbench.data.fetch.command import Settings, fetch
from vprbench.data.fetch.entries import Download, Held, Part
from vprbench.storage.unpack import Wanted

CHUNK = 512 * 1024  # bytes that a download writes at once
NOISE = np.random.default_rng(0).bytes(3 * CHUNK)
SPRING = zipped({"spring/1.png": NOISE, "spring/2.png": b"two"})
SUMMER = tarred({"summer/1.png": b"ONE", "summer/2.png": b"TWO"})
SHA256 = hashlib.sha256(SPRING).hexdigest()
PATIENCE = 60.0  # seconds for what takes hardly any unless something is broken


def spring(*urls: str, **stated: Any) -> Part:
    return Part("spring.zip", urls, Wanted(unpacked_bytes=4 * CHUNK), {"spring": Held(files=2)}, **stated)


def little(**changed: Any) -> Download:
    about = {"description": "a little journey", "licence": "CC BY 4.0", "source": "https://example.org"}
    return Download(**{"name": "little", "datasets": ("little",), "folder": "little", **about, **changed})


def get(entry: Download, root: Path, check: Any = None, timeout_seconds: float = PATIENCE, **settings: Any) -> int:
    given = Settings(root=str(root), **settings)
    return fetch(entry, given, check, timeout_seconds=timeout_seconds, pause_seconds=0.0)


def visible(root: Path) -> list[str]:
    return sorted(str(path.relative_to(root)) for path in root.rglob("*") if not path.name.startswith("."))


def recorded(root: Path) -> dict[str, Any]:
    return dict(json.loads((root / "fetched.json").read_text(encoding="utf-8"))["parts"])


COMPLETE = ["fetched.json", "spring", "spring/1.png", "spring/2.png"]
