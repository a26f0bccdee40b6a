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
from vprbench.api.images import Images
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
    """Keep small pictures of a dataset below a results folder, beside those that are there already.

    Of a large dataset only some frames are kept: those that `shown` names first. Several processes may do so at once; a
    reader finds a whole file or none, and pictures that one adds while another does may be lost until the next run.
    Raises OSError if the disk refuses and BadInput if a frame cannot be read.
    """
    found = load_thumbnails(root, fingerprint)
    _, first_of_place = np.unique(dataset.places, return_index=True)
    queries, references = dataset.queries, dataset.references[first_of_place]
    frames = (
        [*found.queries] if found else [b""] * len(queries),
        [*found.references] if found else [b""] * len(references),
    )
    chosen: tuple[Collection[int], Collection[int]] = range(len(queries)), range(len(references))
    if len(queries) + len(references) > _MOST:
        room = _MOST - sum(map(bool, frames[0] + frames[1]))
        chosen = choose_frames(shown, max(_AT_LEAST, min(_OF_RUN, room)))
    missing = [[n for n in sorted(wanted) if not kept[n]] for wanted, kept in zip(chosen, frames, strict=True)]
    if found is not None and not any(missing):
        return
    for name, images, wanted, kept in zip(
        ("queries", "references"), (queries, references), missing, frames, strict=True
    ):
        for number, image in enumerate(images[np.array(wanted, np.int64)]):
            progress.report(f"keeping small {name}", number / len(wanted))
            kept[wanted[number]] = _encode(image, _SIDE, quality=_QUALITY)
    path = _path(root, fingerprint)
    path.parent.mkdir(exist_ok=True)
    remove_leftovers(path.parent)
    replace_bytes(path, _pack(fingerprint, dataset, references, *frames))


def load_thumbnails(root: Path, fingerprint: str) -> Thumbnails | None:
    """Return the pictures kept of a dataset; None if there are none or, with a warning, if they are damaged."""
    path = _path(root, fingerprint)
    try:
        with zipfile.ZipFile(path) as archive:
            about = json.loads(archive.read(_ABOUT))
            if about["fingerprint"] != fingerprint:
                raise ValueError("they are of another dataset")
            files = {name: archive.read(name) for name in archive.namelist()}
        names = {part: tuple(about[part]) for part in ("queries", "references")}
        return Thumbnails(
            query_names=names["queries"],
            reference_names=names["references"],
            examples=tuple(
                Example(query, place, *(_decode(files[f"examples/{n}-{part}"]) for part in names))
                for n, (query, place) in enumerate(about["examples"])
            ),
            **{part: tuple(files.get(f"{part}/{n}", b"") for n in range(len(names[part]))) for part in names},
        )
    except FileNotFoundError:
        return None
    except Exception as error:  # a damaged file fails in many ways
        logger.warning("%s cannot be used (%s): the next run on that dataset makes it anew", path, error)
        return None


def _path(root: Path, fingerprint: str) -> Path:
    return root / _FOLDER / f"{fingerprint[:16]}.zip"


def _pack(
    fingerprint: str, dataset: Dataset, references: Images, of_queries: Sequence[bytes], of_places: Sequence[bytes]
) -> bytes:
    """Return a ZIP file of the frames that are kept, of examples, and of the names of all."""
    answerable = np.flatnonzero([len(right) > 0 for right in dataset.positives])
    spread = np.linspace(0, len(answerable) - 1, min(_EXAMPLES, len(answerable))).astype(int)
    queries = answerable[spread].tolist()
    examples = [(query, int(dataset.positives[query][len(dataset.positives[query]) // 2])) for query in queries]
    names = {"queries": list(dataset.queries.names), "references": list(references.names)}
    files = {_ABOUT: json.dumps({"fingerprint": fingerprint, **names, "examples": examples}).encode()}
    for part, frames in zip(names, (of_queries, of_places), strict=True):
        files |= {f"{part}/{n}": frame for n, frame in enumerate(frames) if frame}
    for n, (query, place) in enumerate(examples):
        for part, image in zip(names, (dataset.queries[query], references[place]), strict=True):
            files[f"examples/{n}-{part}"] = _encode(image, _EXAMPLE_SIDE, lossless=True)
    written = io.BytesIO()
    with zipfile.ZipFile(written, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return written.getvalue()


def _encode(image: Image, side: int, **options: Any) -> bytes:
    """Return an image as WebP, its longest side at most `side` pixels."""
    picture, buffer = PillowImage.fromarray(image), io.BytesIO()
    picture.thumbnail((side, side))
    picture.save(buffer, "WEBP", method=_EFFORT, **options)
    return buffer.getvalue()


def _decode(webp: bytes) -> Image:
    with PillowImage.open(io.BytesIO(webp), formats=["WEBP"]) as picture:
        return np.asarray(picture.convert("RGB"))
