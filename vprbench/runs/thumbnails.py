"""Small pictures of a dataset's frames, kept beside its runs: figures and the report need no dataset then."""

from __future__ import annotations

import io
import logging
from collections.abc import Collection, Iterable
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

logger = logging.getLogger(__name__)

_FOLDER = "frames"
_EXAMPLE_SIDE = 640  # pixels, the longest
_EXAMPLES = 4
_SIDE, _QUALITY = 96, 50  # of a thumbnail: its longest side in pixels, and WebP's quality; about 1 kB
_EFFORT = 4  # of WebP, 0 to 6
_OF_RUN = 2000  # frames of a large dataset that are kept for one run ...
_MOST = 6000  # ... and for all; a dataset of no more is kept whole


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


def keep(root: Path, fingerprint: str, dataset: Dataset, shown: Shown = ()) -> None:
    """Keep small pictures of a dataset below a results folder, but for those that are there already.

    Of a large dataset only some frames are kept: those that `shown` names first. Several processes may do so at once; a
    reader finds a whole file or none, and what one adds while another does may have to be added again. Raises OSError
    if the disk refuses and BadInput if a frame cannot be read.
    """
    found = find(root, fingerprint)
    _, first_of_place = np.unique(dataset.places, return_index=True)
    traverses = {"queries": dataset.queries, "references": dataset.references[first_of_place]}
    kept = {
        "queries": [*found.queries] if found else [b""] * len(traverses["queries"]),
        "references": [*found.references] if found else [b""] * len(traverses["references"]),
    }
    chosen: tuple[Collection[int], Collection[int]] = range(len(kept["queries"])), range(len(kept["references"]))
    if sum(map(len, kept.values())) > _MOST:
        room = _MOST - sum(1 for frames in kept.values() for frame in frames if frame)
        chosen = choose_frames(shown, min(_OF_RUN, room))
    missing = {
        name: [index for index in sorted(indices) if not kept[name][index]]
        for name, indices in zip(kept, chosen, strict=True)
    }
    if found is not None and not any(missing.values()):
        return
    for name, indices in missing.items():
        images = traverses[name][np.array(indices, np.int64)]
        for number, image in enumerate(images):
            progress.report(f"keeping small {name}", number / len(images))
            kept[name][indices[number]] = _encode(_shrink(image, _SIDE), quality=_QUALITY)
    written = io.BytesIO()
    np.savez_compressed(written, allow_pickle=False, **_content(fingerprint, dataset, traverses["references"], kept))
    path = _path(root, fingerprint)
    path.parent.mkdir(exist_ok=True)
    remove_leftovers(path.parent)
    replace_bytes(path, written.getvalue())


def find(root: Path, fingerprint: str) -> Thumbnails | None:
    """Return the pictures kept of a dataset; None if there are none or, with a warning, if they are damaged."""
    path = _path(root, fingerprint)
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            content = {name: archive[name] for name in archive.files}
        if content["fingerprint"].item() != fingerprint:
            raise ValueError("they are of another dataset")
        return _read_content(content)
    except FileNotFoundError:
        return None
    except Exception as error:  # a damaged file fails in many ways
        logger.warning("%s cannot be used (%s): the next run on that dataset makes it anew", path, error)
        return None


def _path(root: Path, fingerprint: str) -> Path:
    return root / _FOLDER / f"{fingerprint[:16]}.npz"


def _content(
    fingerprint: str, dataset: Dataset, references: Images, kept: dict[str, list[bytes]]
) -> dict[str, npt.NDArray[Any]]:
    """Return the pictures of a dataset as named arrays: the frames that are kept, by traverse, and examples."""
    answerable = [query for query, right in enumerate(dataset.positives) if len(right)]
    spread = np.linspace(0, len(answerable) - 1, min(_EXAMPLES, len(answerable))).astype(int).tolist()
    examples = [answerable[i] for i in spread]
    right = [int(dataset.positives[query][len(dataset.positives[query]) // 2]) for query in examples]
    return {
        "fingerprint": np.array(fingerprint),
        "query_names": np.array(dataset.queries.names),
        "reference_names": np.array(references.names),
        "examples": np.array([examples, right], np.int64),  # (2, n_examples)
        **_pack("queries", kept["queries"]),
        **_pack("references", kept["references"]),
        **_pack("example_queries", (_encode_example(dataset.queries[query]) for query in examples)),
        **_pack("example_references", (_encode_example(references[place]) for place in right)),
    }


def _encode_example(image: Image) -> bytes:
    return _encode(_shrink(image, _EXAMPLE_SIDE), lossless=True)


def _shrink(image: Image, side: int) -> PillowImage.Image:
    """Return an image whose longest side has at most `side` pixels."""
    picture = PillowImage.fromarray(image)
    picture.thumbnail((side, side))
    return picture


def _encode(picture: PillowImage.Image, **options: Any) -> bytes:
    buffer = io.BytesIO()
    picture.save(buffer, "WEBP", method=_EFFORT, **options)
    return buffer.getvalue()


def _pack(name: str, parts: Iterable[bytes]) -> dict[str, npt.NDArray[Any]]:
    """Return byte strings as one array of bytes and one of where each ends."""
    encoded = list(parts)
    ends = np.cumsum([len(part) for part in encoded], dtype=np.int64)
    return {name: np.frombuffer(b"".join(encoded), np.uint8), f"{name}_end": ends}


def _unpack(content: dict[str, npt.NDArray[Any]], name: str) -> tuple[bytes, ...]:
    joined, ends = content[name].tobytes(), content[f"{name}_end"].tolist()
    return tuple(joined[start:end] for start, end in zip([0, *ends], ends, strict=False))


def _read_content(content: dict[str, npt.NDArray[Any]]) -> Thumbnails:
    queries, places = content["examples"].tolist()
    pictures = zip(_unpack(content, "example_queries"), _unpack(content, "example_references"), strict=True)
    kept = Thumbnails(
        query_names=tuple(content["query_names"].tolist()),
        reference_names=tuple(content["reference_names"].tolist()),
        examples=tuple(
            Example(query, place, _decode(asked), _decode(right))
            for query, place, (asked, right) in zip(queries, places, pictures, strict=True)
        ),
        queries=_unpack(content, "queries"),
        references=_unpack(content, "references"),
    )
    if (len(kept.queries), len(kept.references)) != (len(kept.query_names), len(kept.reference_names)):
        raise ValueError("it holds other numbers of frames than of names")
    return kept


def _decode(webp: bytes) -> Image:
    with PillowImage.open(io.BytesIO(webp), formats=["WEBP"]) as picture:
        return np.asarray(picture.convert("RGB"))
