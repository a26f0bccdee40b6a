"""Small pictures of a dataset's frames, kept beside its runs: figures and the report need no dataset then."""

from __future__ import annotations

import io
import json
import logging
import zipfile
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image as PillowImage

from vprbench import progress
from vprbench.api.arrays import Image
from vprbench.api.dataset import Dataset
from vprbench.storage.atomic import remove_leftovers, replace_bytes

logger = logging.getLogger(__name__)

_FOLDER, _ABOUT = "frames", "about.json"
_EXAMPLE_SIDE = 640  # pixels, the longest
_EXAMPLES = 4
_SIDE, _QUALITY = 96, 50  # of a thumbnail: its longest side in pixels, and WebP's quality; about 1 kB
_EFFORT = 4  # of WebP, 0 to 6
_OF_RUN = 2000  # frames of a large dataset that are kept for one run ...
_MOST = 6000  # ... and for all; a dataset of no more is kept whole
_AT_LEAST = 60  # frames that are kept for each run all the same: of the queries that the page opens with


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
    """Keep small pictures of a dataset below a results folder, beside earlier ones.

    Of a large dataset only the frames that `shown` names first are kept. Several processes may do so at once; a
    reader finds a whole file or none, and pictures that one adds while another does may be lost until the next run.
    Raises OSError if the disk refuses and BadInput if a frame cannot be read.
    """
    kept = load_thumbnails(root, fingerprint)
    first_of_place = np.unique(dataset.places, return_index=True)[1]
    images = {"queries": dataset.queries, "references": dataset.references[first_of_place]}
    frames = {part: [*getattr(kept, part)] if kept else [b""] * len(images[part]) for part in images}
    chosen: tuple[Collection[int], ...] = tuple(range(len(part)) for part in frames.values())
    if sum(map(len, frames.values())) > _MOST:
        n_kept = sum(bool(frame) for part in frames.values() for frame in part)
        chosen = choose_frames(shown, max(_AT_LEAST, min(_OF_RUN, _MOST - n_kept)))
    missing = {
        part: [n for n in sorted(wanted) if not frames[part][n]] for part, wanted in zip(frames, chosen, strict=True)
    }
    if kept is not None and not any(missing.values()):
        return
    for part, numbers in missing.items():
        for done, image in enumerate(images[part][np.array(numbers, np.int64)]):
            progress.report(f"keeping small {part}", done / len(numbers))
            frames[part][numbers[done]] = _encode(image, _SIDE, quality=_QUALITY)
    files = {f"{part}/{n}": frame for part in frames for n, frame in enumerate(frames[part]) if frame}
    examples = _choose_examples(dataset)
    for n, pair in enumerate(examples):
        for number, part in zip(pair, images, strict=True):
            files[f"examples/{n}-{part}"] = _encode(images[part][number], _EXAMPLE_SIDE, lossless=True)
    names = {part: [*images[part].names] for part in images}
    about = {"fingerprint": fingerprint, **names, "examples": examples}
    path = _locate(root, fingerprint)
    path.parent.mkdir(exist_ok=True)
    remove_leftovers(path.parent)
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for name, content in {_ABOUT: json.dumps(about).encode(), **files}.items():
            archive.writestr(name, content)
    replace_bytes(path, packed.getvalue())


def load_thumbnails(root: Path, fingerprint: str) -> Thumbnails | None:
    """Return the pictures kept of a dataset; None if there are none or, with a warning, if they are damaged."""
    path = _locate(root, fingerprint)
    try:
        with zipfile.ZipFile(path) as archive:
            files = {name: archive.read(name) for name in archive.namelist()}
        about = json.loads(files[_ABOUT])
        if about["fingerprint"] != fingerprint:
            raise ValueError("they are of another dataset")
        frames = (
            tuple(files.get(f"{part}/{n}", b"") for n in range(len(about[part]))) for part in ("queries", "references")
        )
        examples = (
            Example(query, place, _decode(files[f"examples/{n}-queries"]), _decode(files[f"examples/{n}-references"]))
            for n, (query, place) in enumerate(about["examples"])
        )
        return Thumbnails(tuple(about["queries"]), tuple(about["references"]), tuple(examples), *frames)
    except FileNotFoundError:
        return None
    except Exception as error:  # a damaged file fails in many ways
        logger.warning("%s cannot be used (%s): the next run on that dataset makes it anew", path, error)
        return None


def _locate(root: Path, fingerprint: str) -> Path:
    return root / _FOLDER / f"{fingerprint[:16]}.zip"


def _choose_examples(dataset: Dataset) -> list[tuple[int, int]]:
    """Return a few queries spread over all that have a right place, each with the middle one of its right places."""
    answerable = np.flatnonzero([len(right) > 0 for right in dataset.positives])
    spread = np.linspace(0, len(answerable) - 1, min(_EXAMPLES, len(answerable))).astype(int)
    rights = [(query, dataset.positives[query]) for query in answerable[spread].tolist()]
    return [(query, int(right[len(right) // 2])) for query, right in rights]


def _encode(image: Image, side: int, **options: Any) -> bytes:
    """Return an image as WebP, its longest side at most `side` pixels."""
    picture, buffer = PillowImage.fromarray(image), io.BytesIO()
    picture.thumbnail((side, side))
    picture.save(buffer, "WEBP", method=_EFFORT, **options)
    return buffer.getvalue()


def _decode(webp: bytes) -> Image:
    with PillowImage.open(io.BytesIO(webp), formats=["WEBP"]) as picture:
        return np.asarray(picture.convert("RGB"))
