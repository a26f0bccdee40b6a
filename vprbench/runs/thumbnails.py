"""Small pictures of a dataset's frames, kept beside its runs: figures and the report need no dataset then."""

from __future__ import annotations

import io
import logging
import zipfile
from collections.abc import Collection, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image as PillowImage

from vprbench import progress
from vprbench.api.arrays import Image
from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.storage.atomic import remove_leftovers, replace_bytes
from vprbench.storage.cores import core_count

logger = logging.getLogger(__name__)

_FOLDER = "frames"
_EXAMPLE_SIDE = 640  # pixels, the longest
_EXAMPLES = 4
_THUMBNAIL_BYTES = 780  # on average: 3300 references and 2700 queries fit into 5 MB
_LOOKS = ((96, 65), (96, 50), (96, 35), (96, 20), (80, 20), (64, 20))  # longest side in pixels, quality of WebP
_ALL = 6000  # frames of a dataset that are all kept
_OF_RUN, _MOST = 2000, 8000  # frames of a larger one that are kept for one run, and for all: a page holds no more
_PROBES = 32  # frames of each traverse by which one of these is chosen
_EFFORT = 4  # of WebP, 0 to 6


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


Shown = Iterable[tuple[int, Collection[int]]]  # queries, what matters most first, each with the places beside it


def keep(root: Path, fingerprint: str, dataset: Dataset, shown: Shown = ()) -> None:
    """Keep small pictures of a dataset below a results folder, but for those that are there already.

    Of a large dataset only some frames are kept: those that `shown` names first. Several processes may do so at once; a
    reader finds a whole file or none, and what one adds while another does may have to be added again. Raises OSError
    if the disk refuses and BadInput if a frame cannot be read.
    """
    found = find(root, fingerprint)
    _, first_of_place = np.unique(dataset.places, return_index=True)
    references = dataset.references[first_of_place]
    queries, places = _chosen(found, len(dataset.queries), len(references), shown)
    if found is not None and not queries and not places:
        return
    path = _path(root, fingerprint)
    content = _content(fingerprint, dataset, references, found, queries, places)
    written = io.BytesIO()
    np.savez_compressed(written, allow_pickle=False, **content)
    path.parent.mkdir(exist_ok=True)
    remove_leftovers(path.parent)
    replace_bytes(path, written.getvalue())


def find(root: Path, fingerprint: str) -> Thumbnails | None:
    """Return the pictures kept of a dataset; None if there are none or, with a warning, if they are damaged."""
    path = _path(root, fingerprint)
    try:
        with zipfile.ZipFile(path) as archive:
            damaged = archive.testzip()
        if damaged is not None:
            raise ValueError(f"{damaged} is not what was written")
        with np.load(path, allow_pickle=False) as archive:
            content = {name: archive[name] for name in archive.files}
        if content["fingerprint"].item() != fingerprint:
            raise ValueError("they are of another dataset")
        return _thumbnails(content)
    except FileNotFoundError:
        return None
    except Exception as error:  # what is wrong inside of a file may upset its readers in any way
        logger.warning("%s cannot be used (%s): the next run on that dataset makes it anew", path, error)
        return None


def _path(root: Path, fingerprint: str) -> Path:
    return root / _FOLDER / f"{fingerprint[:16]}.npz"


def _chosen(found: Thumbnails | None, n_queries: int, n_places: int, shown: Shown) -> tuple[list[int], list[int]]:
    """Return the queries and places whose frames are to be added to those that are found, ascending."""
    old_queries = {i for i, frame in enumerate(found.queries) if frame} if found else set()
    old_places = {i for i, frame in enumerate(found.references) if frame} if found else set()
    queries, places = set(range(n_queries)), set(range(n_places))
    if n_queries + n_places > _ALL:
        queries, places = set(), set()
        for query, beside in shown:
            wider = places.union(beside)
            if len(queries) + 1 + len(wider) > _OF_RUN:
                break
            if len(old_queries | queries) + 1 + len(old_places | wider) > _MOST:
                break
            queries.add(query)
            places = wider
    return sorted(queries - old_queries), sorted(places - old_places)


def _content(
    fingerprint: str,
    dataset: Dataset,
    references: Images,
    found: Thumbnails | None,
    queries: Sequence[int],
    places: Sequence[int],
) -> dict[str, npt.NDArray[Any]]:
    """Return everything that is kept of a dataset, as named arrays: what is found, and frames that are added."""
    answerable = [query for query, right in enumerate(dataset.positives) if len(right)]
    spread = np.linspace(0, len(answerable) - 1, min(_EXAMPLES, len(answerable))).astype(int).tolist()
    examples = [answerable[i] for i in spread]
    right = [int(dataset.positives[query][len(dataset.positives[query]) // 2]) for query in examples]
    look = _look([dataset.queries, references])
    small = {
        "queries": [*(found.queries if found else [b""] * len(dataset.queries))],
        "references": [*(found.references if found else [b""] * len(references))],
    }
    frames = [*((dataset.queries, query) for query in queries), *((references, place) for place in places)]
    thumbnails = _small(frames, look)
    for name, indices in (("queries", queries), ("references", places)):
        for index in indices:
            small[name][index] = next(thumbnails)
    return {
        "fingerprint": np.array(fingerprint),
        "query_names": np.array(dataset.queries.names),
        "reference_names": np.array(references.names),
        "examples": np.array([examples, right], np.int64),  # (2, n_examples)
        **_packed("queries", small["queries"]),
        **_packed("references", small["references"]),
        **_packed("example_queries", (_lossless(dataset.queries[query]) for query in examples)),
        **_packed("example_references", (_lossless(references[place]) for place in right)),
    }


def _look(traverses: Sequence[Images]) -> tuple[int, int]:
    """Return the best side and quality at which some frames of each traverse take few enough bytes, or the least."""
    sides = {side for side, _ in _LOOKS}
    probes = [  # shrunk one by one: frames may be large
        {side: _shrunk(image, side) for side in sides}
        for images in traverses
        for image in images[np.linspace(0, len(images) - 1, min(_PROBES, len(images))).astype(np.int64)]
    ]
    for side, quality in _LOOKS:
        if sum(len(_webp(probe[side], quality=quality)) for probe in probes) <= _THUMBNAIL_BYTES * len(probes):
            break
    return side, quality


def _small(frames: Sequence[tuple[Images, int]], look: tuple[int, int]) -> Iterator[bytes]:
    """Yield the thumbnails of frames, given as images and the index of one; as many threads make them as are cores."""
    side, quality = look

    def one(frame: tuple[Images, int]) -> bytes:
        images, index = frame
        return _webp(_shrunk(images[index], side), quality=quality)

    threads = ThreadPoolExecutor(core_count())
    try:
        for done, thumbnail in enumerate(threads.map(one, frames)):
            progress.report("keeping small frames", done / len(frames))
            yield thumbnail
    finally:
        threads.shutdown(cancel_futures=True)


def _lossless(image: Image) -> bytes:
    return _webp(_shrunk(image, _EXAMPLE_SIDE), lossless=True)


def _shrunk(image: Image, side: int) -> PillowImage.Image:
    """Return an image whose longest side has at most `side` pixels."""
    picture = PillowImage.fromarray(image)
    picture.thumbnail((side, side))
    return picture


def _webp(picture: PillowImage.Image, **options: Any) -> bytes:
    buffer = io.BytesIO()
    picture.save(buffer, "WEBP", method=_EFFORT, **options)
    return buffer.getvalue()


def _packed(name: str, parts: Iterable[bytes]) -> dict[str, npt.NDArray[Any]]:
    """Return byte strings as one array of bytes and one of where each ends."""
    encoded = list(parts)
    ends = np.cumsum([len(part) for part in encoded], dtype=np.int64)
    return {name: np.frombuffer(b"".join(encoded), np.uint8), f"{name}_end": ends}


def _unpacked(content: dict[str, npt.NDArray[Any]], name: str) -> tuple[bytes, ...]:
    joined, ends = content[name].tobytes(), content[f"{name}_end"].tolist()
    return tuple(joined[start:end] for start, end in zip([0, *ends], ends, strict=False))


def _thumbnails(content: dict[str, npt.NDArray[Any]]) -> Thumbnails:
    queries, places = content["examples"].tolist()
    pictures = zip(_unpacked(content, "example_queries"), _unpacked(content, "example_references"), strict=True)
    kept = Thumbnails(
        query_names=tuple(content["query_names"].tolist()),
        reference_names=tuple(content["reference_names"].tolist()),
        examples=tuple(
            Example(query, place, _decoded(asked), _decoded(right))
            for query, place, (asked, right) in zip(queries, places, pictures, strict=True)
        ),
        queries=_unpacked(content, "queries"),
        references=_unpacked(content, "references"),
    )
    if (len(kept.queries), len(kept.references)) != (len(kept.query_names), len(kept.reference_names)):
        raise ValueError("it holds other numbers of frames than of names")
    return kept


def _decoded(webp: bytes) -> Image:
    with PillowImage.open(io.BytesIO(webp), formats=["WEBP"]) as picture:
        return np.asarray(picture.convert("RGB"))
