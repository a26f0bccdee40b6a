"""Where the checkout lies, and the real data beside it."""

import os
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def is_readable(folder):
    """Tell whether a folder is there whose files may be listed and opened."""
    own = os.access in os.supports_effective_ids
    return os.access(folder, os.R_OK | os.X_OK, effective_ids=own) and folder.is_dir()


_BESIDE = ROOT.parent / "shared"
# A folder that may not be read is as good as none: its tests say that it is absent.
SHARED = _BESIDE if all(map(is_readable, (_BESIDE, _BESIDE / "data", _BESIDE / "oracles"))) else ROOT / "no-shared"
