"""Trained modules on disk, from which a training that was interrupted goes on."""

from __future__ import annotations

import hashlib
import io
import json
import logging
import os
import re
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

_FOLDER = "VPRBENCH_PARTIAL"  # environment variable
_FORGOTTEN_SECONDS = 30 * 86400.0


class Checkpoints:
    """The finished parts of one training, each a few arrays under a name; several threads may share it.

    A damaged file or a full disk costs the parts that it concerns, never the training.
    """

    def __init__(self, identity: Mapping[str, Any]) -> None:
        """Take over the parts of a training with this identity, plain JSON that decides about the outcome.

        They lie in the folder VPRBENCH_PARTIAL, or in one in the user's cache. Parts that no training has used for 30
        days are removed.
        """
        root = cache_folder(_FOLDER, "partial")
        digest = hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()
        self._folder = root / digest
        self._refused = False
        self.n_loaded = 0  # parts that an earlier, interrupted training had finished
        with suppress(OSError):
            os.utime(self._folder)  # used now
        _remove_forgotten(root)

    def load(self, name: str) -> dict[str, npt.NDArray[Any]] | None:
        """Return the arrays of a part; None if it is not there, or with a warning if it is damaged."""
        path = self._path(name)
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as found:
                arrays = dict(found)
        except FileNotFoundError:
            return None
        except Exception as error:  # a damaged file may upset its reader in any way
            logger.warning("%s cannot be used (%s): that part is trained anew", path, error)
            return None
        self.n_loaded += 1
        return arrays

    def save(self, name: str, arrays: Arrays) -> None:
        """Keep a part, whole or not at all, in place of an earlier one of that name."""
        if self._refused:
            return
        content = io.BytesIO()
        np.savez(content, **arrays)  # type: ignore[arg-type]  # mypy takes them for `allow_pickle`
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            replace_bytes(self._path(name), content.getvalue())
        except OSError as error:
            self._refused = True
            logger.warning(
                "the training cannot be kept in %s (%s): it goes on, but an interruption would cost the rest",
                self._folder,
                error.strerror or error,
            )

    def remove(self) -> None:
        """Remove all parts."""
        shutil.rmtree(self._folder, ignore_errors=True)

    def _path(self, name: str) -> Path:
        return self._folder / f"{name}.npz"


def _remove_forgotten(root: Path) -> None:
    with suppress(OSError):
        for folder in root.iterdir():
            is_ours = re.fullmatch(r"[0-9a-f]{64}", folder.name) is not None
            if is_ours and time.time() - folder.stat().st_mtime > _FORGOTTEN_SECONDS:
                shutil.rmtree(folder, ignore_errors=True)
