"""Where downloaded datasets lie, unless a run says otherwise."""

from __future__ import annotations

import os
from pathlib import Path


def data_folder(name: str) -> Path:
    """Return the folder of a dataset: `data/<name>` where the command runs, or below the folder VPRBENCH_DATA names."""
    return Path(os.environ.get("VPRBENCH_DATA") or "data").expanduser() / name
