"""Where downloaded datasets lie, unless a run says otherwise."""

from __future__ import annotations

import os
from pathlib import Path

from vprbench.homes import expanded


def data_folder(name: str) -> Path:
    """Return the folder of a dataset: `data/<name>` where the command runs, or below the folder VPRBENCH_DATA names."""
    return expanded("VPRBENCH_DATA", os.environ.get("VPRBENCH_DATA") or "data") / name
