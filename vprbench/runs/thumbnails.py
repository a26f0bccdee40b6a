"""Small pictures of a dataset's frames, kept beside its runs: figures and the report need no dataset then."""

from __future__ import annotations

import io
import json
import logging
import zipfile
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image as PillowImage

from vprbench import progress
from vprbench.api.arrays import Image
from vprbench.api.dataset import Dataset
from vprbench.storage.atomic import replace_bytes

logger = logging.getLogger(__name__)

_EXAMPLES, _EXAMPLE_SIDE = 4, 640  # pairs of pictures without loss, and their longest side in pixels
_SIDE = 96  # of a thumbnail: its longest side in pixels, which makes about 1 kB
_MOST = 6000  # thumbnails of a dataset; a dataset of no more frames is kept whole
_OF_FURTHER_RUN = 60  # that a further run adds: of the queries that its page opens with


@dataclass(frozen=True)
class Example:
    """A query beside the place that is right for it, without loss."""

    query: int
    place: int
    query_image: Image
    reference_image: Image


@dataclass(frozen=True)
class Thumbnails:
    """Frames of a dataset, small: of queries, and the first reference image of places."""

    query_names: tuple[str, ...]
    reference_names: tuple[str, ...]  # by place
    examples: tuple[Example, ...]  # spread over the queries that have a right place
    queries: tuple[bytes, ...]  # WebP, by query; empty if it is not kept
    references: tuple[bytes, ...]  # WebP, by place


Shown = Iterable[tuple[int, Collection[int]]]  # queries, most important first, each with the places beside it


def choose_frames(shown: Shown, most: int) -> tuple[set[int], set[int]]:
    """Return queries and places from the beginning of `shown`, as many as make `most` frames together."""
    queries: set[int] = set()
    places: set[int] = set()
    for query, beside in shown:
        wider = places.union(beside)
        if len(queries | {query}) + len(wider) > most:
            break
        queries.add(query)
        places = wider
    return queries, places


def save_thumbnails(root: Path, fingerprint: str, dataset: Dataset, shown: Shown = ()) -> None:
    """Keep small pictures of a dataset below a results folder, beside those of earlier runs.

    Of a large dataset only the frames that `shown` names first are kept, of each further run a few. A reader finds a
    whole file or none. Raises OSError if the disk refuses and BadInput if a frame cannot be read.
    """
    kept = load_thumbnails(root, fingerprint)
    first_of_place = np.unique(dataset.places, return_index=True)[1]
    images = {"queries": dataset.queries, "references": dataset.references[first_of_place]}
    wanted: Sequence[Iterable[int]] = [range(len(part)) for part in images.values()]
    if sum(map(len, images.values())) > _MOST:
        wanted = choose_frames(shown, _MOST if kept is None else _OF_FURTHER_RUN)
    files = {f"{part}/{n}": frame for part in images for n, frame in enumerate(getattr(kept, part, ())) if frame}
    missing = [
        sorted(n for n in numbers if f"{part}/{n}" not in files) for part, numbers in zip(images, wanted, strict=True)
    ]
    if kept is not None and not any(missing):
        return
    for part, numbers in zip(images, missing, strict=True):
        for done, image in enumerate(images[part][np.array(numbers, np.int64)]):
            progress.report(f"keeping small {part}", done / len(numbers))
            files[f"{part}/{numbers[done]}"] = _encode_webp(image, _SIDE, quality=50)
    examples = _choose_examples(dataset)
    for number, pair in enumerate(examples):
        for part, n in zip(images, pair, strict=True):
            files[f"examples/{number}-{part}"] = _encode_webp(images[part][n], _EXAMPLE_SIDE, lossless=True)
    about = {"examples": examples, **{part: [*images[part].names] for part in images}}
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for name, content in {**files, "about.json": json.dumps(about).encode()}.items():
            archive.writestr(name, content)
    (root / "frames").mkdir(exist_ok=True)
    replace_bytes(root / "frames" / f"{fingerprint}.zip", packed.getvalue())


def load_thumbnails(root: Path, fingerprint: str) -> Thumbnails | None:
    """Return the pictures kept of a dataset; None if there are none or, with a warning, if they are damaged."""
    path = root / "frames" / f"{fingerprint}.zip"
    try:
        with zipfile.ZipFile(path) as archive:
            files = {name: archive.read(name) for name in archive.namelist()}
        about = json.loads(files["about.json"])
        parts = ("queries", "references")
        names = [tuple(about[part]) for part in parts]
        frames = [tuple(files.get(f"{part}/{n}", b"") for n in range(len(about[part]))) for part in parts]
        pairs = [[_decode_webp(files[f"examples/{n}-{part}"]) for part in parts] for n in range(len(about["examples"]))]
        examples = tuple(Example(*numbers, *pair) for numbers, pair in zip(about["examples"], pairs, strict=True))
        return Thumbnails(names[0], names[1], examples, frames[0], frames[1])
    except FileNotFoundError:
        return None
    except Exception as error:  # a damaged file fails in many ways
        logger.warning("%s cannot be used (%s): the next run on that dataset makes it anew", path, error)
        return None


def _choose_examples(dataset: Dataset) -> list[tuple[int, int]]:
    """Return a few queries spread over all that have a right place, each with the middle one of its right places."""
    answerable = np.flatnonzero([len(right) > 0 for right in dataset.positives])
    spread = np.linspace(0, len(answerable) - 1, min(_EXAMPLES, len(answerable))).astype(int)
    rights = [(query, dataset.positives[query]) for query in answerable[spread].tolist()]
    return [(query, int(right[len(right) // 2])) for query, right in rights]


def _encode_webp(image: Image, side: int, **options: Any) -> bytes:
    """Return an image as WebP, its longest side at most `side` pixels."""
    picture, buffer = PillowImage.fromarray(image), io.BytesIO()
    picture.thumbnail((side, side))
    picture.save(buffer, "WEBP", **options)
    return buffer.getvalue()


def _decode_webp(webp: bytes) -> Image:
    with PillowImage.open(io.BytesIO(webp), formats=["WEBP"]) as picture:
        return np.asarray(picture.convert("RGB"))
