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


def find_tuned_queries(dataset: Dataset, tuned_on: Mapping[str, Any]) -> list[int]:
    """Return the queries that show frames by which a method was tuned, or whose right places do; ascending.

    `tuned_on` is the declaration of the method. The content of its file identifies a frame, or its pixels if it is in
    memory. No query is found if frames are computed, or if no conf folder has `shared/tuned_frames/DATASET.txt`.

    Raises:
        BadInput: a file cannot be read.
    """
    name = f"{tuned_on.get('dataset', '')}.txt"
    paths = [folder / "shared" / "tuned_frames" / name for folder in entries.conf_folders().values()]
    lists = [path for path in paths if path.is_file()]
    if not lists:
        return []
    codes = _read_codes(lists[0])
    tuned_queries = _find_frames(dataset.queries, codes)
    tuned_places = np.unique(dataset.places[_find_frames(dataset.references, codes)])
    right_is_tuned = [bool(np.isin(right, tuned_places).any()) for right in dataset.positives]
    return np.flatnonzero(tuned_queries | np.array(right_is_tuned, np.bool_)).tolist()


def _find_frames(images: Images, codes: Codes) -> npt.NDArray[np.bool_]:
    """Return which images have one of the codes, (n_images,)."""
    own = images.content_codes()
    return np.zeros(len(images), np.bool_) if own is None else np.isin(own >> np.uint64(_UNUSED_BITS), codes)


@cache
def _read_codes(path: Path) -> Codes:
    lines = path.read_text(encoding="utf-8").splitlines()
    return np.array([int(code, 16) for line in lines if line[:1] != "#" for code in line.split()], np.uint64)
