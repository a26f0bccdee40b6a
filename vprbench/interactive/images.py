"""A dataset of images in hand: folders, lists of files, or arrays."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.api.arrays import Image
from vprbench.api.dataset import Dataset
from vprbench.api.decoding import as_rgb, read_image
from vprbench.api.images import Images
from vprbench.errors import BadInput
from vprbench.interactive import short
from vprbench.plugins import registry
from vprbench.text import plural

#: One traverse: a folder, a list of image files, a list of arrays (height, width) or (height, width, 3), or one array
#: of images (n, height, width) or (n, height, width, 3); uint8.
Traverse = str | Path | Sequence[str | Path] | Sequence[npt.NDArray[Any]] | npt.NDArray[Any]


class OwnImages(Dataset):
    """A dataset of images in hand, which shows itself in one line."""

    def __repr__(self) -> str:
        sizes = zip((self.n_places, len(self.references), len(self.queries)), ("place", "image", "query"), strict=True)
        return short(f"<dataset {self.name}: {', '.join(plural(*size) for size in sizes)}>")


def dataset_of(
    references: Traverse | Sequence[Traverse],
    queries: Traverse,
    name: str = "images",
    tolerance: int = 0,
    positives: Sequence[int] | Sequence[Sequence[int]] | npt.NDArray[Any] | None = None,
) -> Dataset:
    """Return the dataset of your own images; the i-th image of every reference traverse shows place i.

    `references` is a traverse or a list of traverses. Right for the i-th query are the places i - tolerance to
    i + tolerance, or what `positives` says: a place or a list of places for each query, or a matrix of booleans
    (n_queries, n_places). A query without a right place counts as a miss. Raises NotThere for a folder without images,
    BadInput for what is no image and for parts that do not fit one another.
    """
    several = [_listed(each, "references") for each in _traverses(references)]
    asked = _listed(queries, "queries")
    counts = sorted({len(images) for images in several})
    if len(counts) > 1:
        raise BadInput(
            f"references: the traverses have {' and '.join(map(str, counts))} images; wanted as many in each"
        )
    n_places, n_queries = counts[0], len(asked)
    given = positives is not None
    if tolerance < 0 or (given and tolerance):
        raise BadInput(f"tolerance={tolerance}: give 0 or more places, and 0 with positives, which say all")
    right = _right_places(positives, n_queries, n_places) if given else _by_number(n_queries, n_places, tolerance)
    without = sum(not len(places) for places in right)
    if without and not given:
        raise BadInput(
            f"{without} of {plural(n_queries, 'query')} have no reference within {plural(tolerance, 'place')}: give as "
            "many queries as places, or positives=, the right places of each query"
        )
    notes = (f"{without} of {plural(n_queries, 'query')} have no right place: they count as misses",) * bool(without)
    truth = {"ground_truth": "given"} if given else {"ground_truth": "index", "tolerance_places": tolerance}
    return OwnImages(
        name=name,
        references=_images([image for images in several for image in images]),
        places=np.tile(np.arange(n_places), len(several)),
        queries=_images(asked),
        positives=right,
        protocol={
            "protocol": "images",
            "references": [_called(each) for each in _traverses(references)],
            "queries": _called(queries),
            **truth,
        },
        notes=notes,
    )


def _traverses(references: Any) -> list[Any]:
    """Return each traverse of what may be one or a list of them."""
    if isinstance(references, str | Path) or not isinstance(references, Sequence) or not references:
        return [references]
    first = references[0]
    if isinstance(first, str | Path):
        return list(references) if Path(first).expanduser().is_dir() else [references]
    images = isinstance(first, np.ndarray) and (first.ndim == 2 or (first.ndim == 3 and first.shape[2] in (3, 4)))
    return [references] if images or not isinstance(first, Sequence | np.ndarray) else list(references)


def _listed(traverse: Any, option: str) -> Sequence[Path] | list[Image]:
    """Return the files or the arrays of one traverse; raises what `dataset_of` raises, naming the `option`."""
    if isinstance(traverse, str | Path):
        reader = registry.module_beside(registry.entries("dataset")["folders"], "readers.image_files")
        found: Sequence[Path] = reader.images_in(traverse, option, "give a folder of images")
        return found
    if isinstance(traverse, np.ndarray) and traverse.ndim == 3 and traverse.shape[2] in (3, 4):
        raise BadInput(f"{option} is one image of shape {traverse.shape}; wanted several: a list of images")
    if not isinstance(traverse, Sequence | np.ndarray):
        raise BadInput(f"{option} is of type {type(traverse).__name__}; wanted a folder, a list of images or an array")
    if all(isinstance(image, str | Path) for image in traverse):
        return [Path(image).expanduser() for image in traverse]
    images: list[Image] = []
    for number, image in enumerate(traverse):
        try:
            images.append(as_rgb(np.asarray(image)))
        except BadInput as error:
            raise BadInput(f"{option}, image {number}: {error}") from error
    return images


def _images(listed: Sequence[Path | Image]) -> Images:
    files = [image for image in listed if isinstance(image, Path)]
    if len(files) == len(listed):
        return Images.from_files(files)
    return Images.from_arrays([read_image(image) if isinstance(image, Path) else image for image in listed])


def _by_number(n_queries: int, n_places: int, tolerance: int) -> tuple[npt.NDArray[np.int64], ...]:
    ends = [(max(0, query - tolerance), min(n_places, query + tolerance + 1)) for query in range(n_queries)]
    return tuple(np.arange(first, last, dtype=np.int64) for first, last in ends)


def _right_places(positives: Any, n_queries: int, n_places: int) -> tuple[npt.NDArray[np.int64], ...]:
    """Return the right places of each query, ascending; raises BadInput for what names none."""
    if len(positives) != n_queries:
        raise BadInput(f"positives: right places of {len(positives)} queries came, and there are {n_queries}")
    found = []
    for query, right in enumerate(positives):
        row = np.asarray(right)
        if row.dtype == bool:
            if row.shape != (n_places,):
                raise BadInput(
                    f"positives of query {query}: {row.shape} booleans came; wanted one for each of {n_places}"
                )
            row = np.flatnonzero(row)
        elif row.size and row.dtype.kind not in "iu":
            raise BadInput(f"positives of query {query}: {right!r} came; wanted numbers of places, or booleans")
        found.append(np.unique(row.reshape(-1).astype(np.int64)))
    return tuple(found)


def _called(traverse: Any) -> str:
    """Return what a record calls a traverse: the name of its folder, or what it is made of."""
    if isinstance(traverse, str | Path):
        return Path(traverse).expanduser().resolve().name
    return "files" if isinstance(traverse[0], str | Path) else "arrays"
