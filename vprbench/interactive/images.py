"""A dataset of images in hand: folders, lists of files, or arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array, issparse, sparray, spmatrix

from vprbench.api.arrays import Image
from vprbench.api.dataset import Dataset, SharedFrames
from vprbench.api.decoding import Decoding, Exif, as_rgb, read_image
from vprbench.api.images import Images
from vprbench.api.levels import decoding_of
from vprbench.errors import BadInput
from vprbench.interactive import short
from vprbench.plugins import registry
from vprbench.plugins.values import check_value
from vprbench.storage.paths import Paths
from vprbench.text import plural

#: One traverse: a folder, a list of image files, a list of arrays (height, width) or (height, width, 3), or one array
#: of images (n, height, width) or (n, height, width, 3); uint8.
Traverse = str | Path | Sequence[str | Path] | Sequence[npt.NDArray[Any]] | npt.NDArray[Any]


_WAYS_OUT = (
    "give as many in each, or say what is right by positives= (the right places of each query) or by "
    'vprbench.dataset("image_list") (places or positions)'
)


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
    positives: Sequence[int] | Sequence[Sequence[int]] | npt.NDArray[Any] | spmatrix | sparray | None = None,
    numbers: Literal["auto", "decimal", "whole"] = "auto",
    breaks: Literal["auto", "none"] = "auto",
    exif: Exif = "obey",
    levels: str | None = None,
    shared_frames: SharedFrames = "error",
    ground_truth: Literal["index", "none"] = "index",
) -> Dataset:
    """Return the dataset of your own images; the i-th image of every reference traverse shows place i.

    `references` is a traverse or a list of traverses. Right for the i-th query are the places i - tolerance to
    i + tolerance, or what `positives` says: a place or a list of places for each query, or a matrix (n_queries,
    n_places) of booleans or of 0 and 1, dense or a sparse one of scipy. Of as many queries as places, nothing tells a
    matrix from its transpose: rows have to be queries. With `ground_truth="none"` every reference image is a place,
    traverses may differ in length, and no answer is judged. A query without a right place counts as a miss. A folder is
    read in the order of the numbers in its names, which are decimal (0.25 before 0.5) or whole; by default the names
    tell. Where files lie in another folder than those before, another drive begins unless `breaks` is none: tolerance
    and sequences end there. `exif` and `levels` say how files are decoded (`decoding_of`). A run whose queries are
    among its references raises BadInput, with `shared_frames` "allow" it has a note. Raises NotThere for a folder
    without images, BadInput for what is no image and for parts that do not fit one another.
    """
    for option, value, known in (
        ("numbers", numbers, ("auto", "decimal", "whole")),
        ("breaks", breaks, ("auto", "none")),
    ):
        if value not in known:
            raise BadInput(f"{option}={value}: choose {', '.join(known)}")
    judged = ground_truth == "index"
    if ground_truth not in ("index", "none") or (not judged and (positives is not None or tolerance)):
        raise BadInput(f"ground_truth={ground_truth}: give index, or none without positives and tolerance")
    given = positives is not None
    parts, read, notes = _in_order([*_traverses(references), queries], numbers)
    *several, asked = parts
    if not len(several[0]):
        raise BadInput("references hold no reference image: give a folder, or at least one image")
    names = [*(f"references[{number}]" for number in range(len(several))), "queries"]
    drives = _reader("drives")
    if judged:
        drives.check_by_order(several if given else parts, names[:-1] if given else names, breaks, "", _WAYS_OUT)
    n_places, n_queries = len(several[0]) if judged else sum(map(len, several)), len(asked)
    if tolerance < 0 or (given and tolerance):
        raise BadInput(f"tolerance={tolerance}: give 0 or more places, and 0 with positives, which say all")
    mapped = [image for images in several for image in images]
    places = np.tile(np.arange(n_places), len(several)) if judged else np.arange(n_places)
    starts = drives.drive_starts(_files(mapped), _files(asked), breaks)
    place_breaks, query_breaks = starts.of_places(places), starts.queries
    broken = len(place_breaks) + len(query_breaks) > 0
    right: tuple[npt.NDArray[np.int64], ...] = (np.empty(0, np.int64),) * n_queries
    if given:
        right = _right_places(positives, n_queries, n_places)
    elif judged:
        by_number = _by_number(n_queries, n_places, tolerance)
        right = tuple(drives.right_in_drive(by_number, np.union1d(place_breaks, query_breaks)))
    if not judged:
        notes.append("there is no ground truth, so no answer is judged (ground_truth=none)")
    elif without := sum(not len(places) for places in right):
        notes.append(f"{without} of {plural(n_queries, 'query')} have no right place: they count as misses")
    truth: dict[str, Any] = {"ground_truth": "given" if given else ground_truth}
    if judged and not given:
        truth["tolerance_places"] = tolerance
    decoding, decoded = decoding_of([image for image in [*mapped, *asked] if isinstance(image, Path)], exif, levels)
    return OwnImages(
        name=name,
        references=_images(mapped, decoding),
        places=places,
        queries=_images(asked, decoding),
        positives=right,
        protocol={
            "protocol": "images",
            "references": [_called(each) for each in _traverses(references)],
            "queries": _called(queries),
            **truth,
            **read,
            **({"breaks": starts.seen_by} if broken else {}),
            **decoded,
        },
        query_breaks=query_breaks if broken else None,
        place_breaks=place_breaks if broken else None,
        by_order=judged and not given,
        notes=tuple(notes),
    ).with_shared_frames(check_value("shared_frames", shared_frames, SharedFrames))


def _traverses(references: Any) -> list[Any]:
    """Return each traverse of what may be one or a list of them."""
    if isinstance(references, str | Path) or not isinstance(references, Sequence) or not references:
        return [references]
    first = references[0]
    if isinstance(first, str | Path):
        return list(references) if Path(first).expanduser().is_dir() else [references]
    images = isinstance(first, np.ndarray) and (first.ndim == 2 or (first.ndim == 3 and first.shape[2] in (3, 4)))
    return [references] if images or not isinstance(first, Sequence | np.ndarray) else list(references)


def _in_order(traverses: Sequence[Any], numbers: str) -> tuple[list[Any], dict[str, Any], list[str]]:
    """Return traverses, folders in the order of the numbers in their names, and what protocol and notes say of it."""
    options = [*["references"] * (len(traverses) - 1), "queries"]
    found = [_listed(each, option) for each, option in zip(traverses, options, strict=True)]
    folders = [number for number, images in enumerate(found) if isinstance(images, Paths)]
    ordered, read, notes = _reader("name_order").by_numbers([found[number] for number in folders], numbers, "numbers")
    for number, files in zip(folders, ordered, strict=True):
        found[number] = files
    return found, read, notes


def _reader(name: str) -> Any:
    """Return one of the modules by which datasets of files are read."""
    return registry.module_beside(registry.entries("dataset")["folders"], f"readers.{name}")


def _listed(traverse: Any, option: str) -> Sequence[Path] | list[Image]:
    """Return the files or the arrays of one traverse; raises what `dataset_of` raises, naming the `option`."""
    if isinstance(traverse, str | Path):
        found: Paths = _reader("image_files").images_in(traverse, option, "give a folder of images")
        return found
    if isinstance(traverse, Sequence | np.ndarray) and not len(traverse):
        raise BadInput(f"{option} holds no image; wanted at least one (did a pattern find no file?)")
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


def _files(listed: Sequence[Path | Image]) -> Sequence[Path]:
    """Return images as files; nothing if some are arrays, which lie in no folder."""
    files = [image for image in listed if isinstance(image, Path)]
    return Paths.of(files) if len(files) == len(listed) else ()


def _images(listed: Sequence[Path | Image], decoding: Decoding) -> Images:
    files = [image for image in listed if isinstance(image, Path)]
    if len(files) == len(listed):
        return Images.from_files(files, decoding)
    return Images.from_arrays([read_image(image, decoding) if isinstance(image, Path) else image for image in listed])


def _by_number(n_queries: int, n_places: int, tolerance: int) -> tuple[npt.NDArray[np.int64], ...]:
    ends = [(max(0, query - tolerance), min(n_places, query + tolerance + 1)) for query in range(n_queries)]
    return tuple(np.arange(first, last, dtype=np.int64) for first, last in ends)


def _right_places(positives: Any, n_queries: int, n_places: int) -> tuple[npt.NDArray[np.int64], ...]:
    """Return the right places of each query, ascending; raises BadInput for what names none."""
    if issparse(positives):
        return _of_sparse_matrix(positives, n_queries, n_places)
    try:
        given = np.asarray(positives)
    except ValueError:  # lists of unequal length
        given = np.empty(0, object)
    if _is_matrix(given, n_queries, n_places):
        _check_matrix(given.shape, n_queries, n_places)
        return tuple(np.flatnonzero(row) for row in given)
    rows = given if given.ndim == 2 else positives
    if isinstance(positives, Mapping) or len(rows) != n_queries:
        raise BadInput(f"positives: right places of {len(rows)} queries came, and there are {n_queries}: give a list")
    found = []
    for query, right in enumerate(rows):
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


def _of_sparse_matrix(positives: Any, n_queries: int, n_places: int) -> tuple[npt.NDArray[np.int64], ...]:
    """Return the right places of each query, ascending, that a sparse matrix of scipy says."""
    _check_matrix(positives.shape, n_queries, n_places)
    matrix = csr_array(positives, copy=True)
    matrix.sum_duplicates()
    if not np.isin(matrix.data, (0, 1)).all():
        raise BadInput(f"positives holds {matrix.dtype} values other than 0 and 1: yes and no are wanted")
    matrix.eliminate_zeros()
    return tuple(np.split(matrix.indices.astype(np.int64), matrix.indptr[1:-1]))


def _is_matrix(given: npt.NDArray[Any], n_queries: int, n_places: int) -> bool:
    """Tell whether a table says yes and no for every place, rather than which places are right.

    It does if it holds booleans, or 0 and 1 alone, as fractions or so that a list of places would name one twice or
    one that there is not. Raises BadInput for what may be both.
    """
    if given.ndim != 2 or not given.size or given.dtype.kind not in "buif" or not np.isin(given, (0, 1)).all():
        return False
    each_once = given.shape[1] < 3 and bool((np.diff(given.astype(int), axis=1) != 0).all())
    if given.dtype.kind in "bf" or not each_once or given.max(initial=0) >= n_places:
        return True
    if given.shape != (n_queries, n_places):
        return False
    raise BadInput(
        f"positives={given.tolist()[:2]} and so on may be a matrix of yes and no, or lists of places: give "
        f"np.array(positives, bool) if it is a matrix, np.ones({given.shape}, bool) if it lists places"
    )


def _check_matrix(shape: tuple[int, ...], n_queries: int, n_places: int) -> None:
    if shape != (n_queries, n_places):
        turned = ", places by queries: pass positives.T" if shape == (n_places, n_queries) else ""
        raise BadInput(
            f"positives: a matrix of shape {shape} came{turned}; wanted are booleans, or 0 and 1, of shape "
            f"{(n_queries, n_places)}, queries by places"
        )


def _called(traverse: Any) -> str:
    """Return what a record calls a traverse: the name of its folder, or what it is made of."""
    if isinstance(traverse, str | Path):
        return Path(traverse).expanduser().resolve().name
    return "files" if isinstance(traverse[0], str | Path) else "arrays"
