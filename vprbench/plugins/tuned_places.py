"""The places on which a method's settings were chosen: declared by `tuned_on` of its yaml, found by their frames."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from vprbench.api.dataset import Dataset
from vprbench.api.images import Codes, Images
from vprbench.plugins import entries
from vprbench.plugins.options import check_value

UNKNOWN = "unknown"
_RANGES = re.compile(r" *\d+ *- *\d+ *(, *\d+ *- *\d+ *)*")
_UNUSED_BITS = 16  # of a code: the files keep 12 of its 16 hexadecimal digits


@dataclass(frozen=True)
class TunedOn:
    """The places on which the settings of a method were chosen: the key `tuned_on` of its yaml."""

    dataset: str  # its name, as runs hold it
    places: str  # their numbers there, ends included: 0-999, or 0-99,200-299; any other words: the numbers are unknown
    also_in: dict[str, str] | tuple[str, ...] = ()  # other datasets that show them, with or without the numbers there

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}


def parse_tuned_on(given: Any, where: object) -> dict[str, Any]:
    """Return a declared `tuned_on` as plain values; raises BadInput that names the yaml or method `where` it stands."""
    tuned: TunedOn = check_value(f"{where}: tuned_on", given, TunedOn)
    also = tuned.also_in if isinstance(tuned.also_in, Mapping) else dict.fromkeys(tuned.also_in, UNKNOWN)
    return {**asdict(tuned), "also_in": dict(also)}


def parse_places(places: str) -> list[tuple[int, int]] | None:
    """Return the first and the last number of each range of declared places; None if they hold no numbers."""
    if _RANGES.fullmatch(places) is None:
        return None
    found = [(int(first), int(last)) for first, last in re.findall(r"(\d+) *- *(\d+)", places)]
    return found if all(first <= last for first, last in found) else None


def list_tuned_queries(dataset: Dataset, tuned_on: Mapping[str, Any]) -> list[int]:
    """Return the queries that show frames by which a method was tuned, or whose right places do; ascending.

    `tuned_on` is the declaration of the method. The content of its file identifies a frame, or its pixels if it is in
    memory. No query is found if frames are computed, or if no conf folder has `shared/tuned_frames/DATASET.txt`.
    """
    name = f"{tuned_on.get('dataset', '')}.txt"
    paths = [folder / "shared" / "tuned_frames" / name for folder in entries.find_conf_folders().values()]
    path = next(filter(Path.is_file, paths), None)
    if path is None:
        return []
    codes = _read_codes(path)
    tuned_places = dataset.places[_find_frames(dataset.references, codes)]
    right_is_tuned = [bool(np.isin(right, tuned_places).any()) for right in dataset.positives]
    return np.flatnonzero(_find_frames(dataset.queries, codes) | np.array(right_is_tuned, np.bool_)).tolist()


def _find_frames(images: Images, codes: Codes) -> npt.NDArray[np.bool_]:
    """Return which images have one of the codes, (n_images,)."""
    own = images.content_codes()
    return np.zeros(len(images), np.bool_) if own is None else np.isin(own >> np.uint64(_UNUSED_BITS), codes)


@cache
def _read_codes(path: Path) -> Codes:
    lines = path.read_text(encoding="utf-8").splitlines()
    return np.array([int(code, 16) for line in lines if line[:1] != "#" for code in line.split()], np.uint64)
