"""Trained modules on disk, from which a training that was interrupted goes on."""

from __future__ import annotations

import hashlib
import io
import json
import logging
import os
import shutil
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.api import cache_folder, replace_bytes

logger = logging.getLogger(__name__)

Arrays = Mapping[str, npt.NDArray[Any]]

_FORGOTTEN_SECONDS = 30 * 86400.0


class Checkpoints:
    """The finished parts of one training, each a few arrays under a name; several threads may share it.

    A full disk costs the parts that it refuses, never the training.
    """

    def __init__(self, identity: Mapping[str, Any]) -> None:
        """Take over the parts of a training with this identity, plain JSON that decides about the outcome.

        They lie in the folder VPRBENCH_PARTIAL, or in one in the user's cache. Parts that no training has used for 30
        days are removed.
        """
        root = cache_folder("VPRBENCH_PARTIAL", "partial")
        self._folder = root / hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()
        self.n_loaded = 0  # parts that an earlier, interrupted training had finished
        with suppress(OSError):
            os.utime(self._folder)  # used now
        for folder in root.glob("[0-9a-f]" * 64):
            with suppress(OSError):
                if time.time() - folder.stat().st_mtime > _FORGOTTEN_SECONDS:
                    shutil.rmtree(folder, ignore_errors=True)

    def load(self, name: str) -> dict[str, npt.NDArray[Any]] | None:
        """Return the arrays of a part; None if it is not there."""
        path = self._locate(name)
        if not path.is_file():
            return None
        with np.load(path, allow_pickle=False) as found:
            arrays = dict(found)
        self.n_loaded += 1
        return arrays

    def save(self, name: str, arrays: Arrays) -> None:
        """Keep a part, whole or not at all, in place of an earlier one of that name."""
        content = io.BytesIO()
        np.savez(content, **arrays)  # type: ignore[arg-type]  # mypy takes them for `allow_pickle`
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            replace_bytes(self._locate(name), content.getvalue())
        except OSError as error:
            logger.warning("%s cannot be kept (%s): after an interruption it is trained again", name, error)

    def remove(self) -> None:
        """Remove all parts."""
        if self._folder.is_dir():
            shutil.rmtree(self._folder, ignore_errors=True)

    def _locate(self, name: str) -> Path:
        return self._folder / f"{name}.npz"
