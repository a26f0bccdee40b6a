"""The frames that a method's settings were chosen on, known by hashes of their content in any dataset."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.api.dataset import Dataset
from vprbench.api.images import Codes, Images
from vprbench.plugins import entries

_UNUSED_BITS = 16  # of a code: the files keep 12 of its 16 hexadecimal digits


def queries_of_tuned_frames(dataset: Dataset, tuned_on: Mapping[str, Any]) -> list[int]:
    """Return the queries that show frames by which a method was tuned, or whose right places do; ascending.

    `tuned_on` is what the method declares. A frame is known by the content of its file, of one in memory by its
    pixels; none is known if frames are computed, or if no conf folder has `shared/tuned_frames/DATASET.txt`. Raises
    BadInput for a file that cannot be read.
    """
    known = _known_codes(str(tuned_on.get("dataset", "")))
    if not len(known):
        return []
    asked, mapped = (_are_among(part, known) for part in (dataset.queries, dataset.references))
    places = np.unique(dataset.places[mapped])
    shown = [bool(asks) or bool(np.isin(r, places).any()) for asks, r in zip(asked, dataset.positives, strict=True)]
    return np.flatnonzero(shown).tolist()


def _are_among(images: Images, known: Codes) -> npt.NDArray[np.bool_]:
    codes = images.content_codes()
    return np.zeros(len(images), np.bool_) if codes is None else np.isin(codes >> np.uint64(_UNUSED_BITS), known)


def _known_codes(dataset: str) -> Codes:
    """Return the codes of the frames of a dataset that methods were tuned on; none if nobody keeps them."""
    paths = (folder / "shared" / "tuned_frames" / f"{dataset}.txt" for folder in entries.conf_folders().values())
    return next((_codes_in(path) for path in paths if path.is_file()), np.zeros(0, np.uint64))


@cache
def _codes_in(path: Path) -> Codes:
    lines = path.read_text(encoding="utf-8").splitlines()
    return np.array([int(code, 16) for line in lines if line[:1] != "#" for code in line.split()], np.uint64)
