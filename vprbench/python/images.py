"""A dataset of images in hand: folders, lists of files, or arrays, read as the dataset `folders` reads its own."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, Literal, get_type_hints

import numpy as np
import numpy.typing as npt
from pydantic import NonNegativeInt
from scipy.sparse import sparray, spmatrix

from vprbench.api.arrays import Image
from vprbench.api.dataset import Dataset, SharedFrames
from vprbench.api.decimal_names import NumberReading, order_by_numbers
from vprbench.api.decoding import Exif, as_rgb, read_image
from vprbench.api.images import Images
from vprbench.api.levels import decoding_of
from vprbench.errors import BadInput
from vprbench.plugins import registry
from vprbench.plugins.options import check_values
from vprbench.python.choices import as_plain
from vprbench.storage.paths import Paths

#: One traverse: a folder, a list of image files, a list of arrays (height, width) or (height, width, 3), or one array
#: of images (n, height, width) or (n, height, width, 3); uint8.
Traverse = str | Path | Sequence[str | Path] | Sequence[npt.NDArray[Any]] | npt.NDArray[Any]

_Read = Paths | list[Path] | Images  # the files of a folder, listed files, arrays
_REMEDY = (
    "give as many in each, or say what is right by positives= (the right places of each query) or by "
    'vprbench.dataset("image_list") (places or positions)'
)


def dataset_of(
    references: Traverse | Sequence[Traverse],
    queries: Traverse,
    name: str = "images",
    tolerance: NonNegativeInt = 0,
    positives: Sequence[int] | Sequence[Sequence[int]] | npt.NDArray[Any] | spmatrix | sparray | None = None,
    numbers: NumberReading = "auto",
    breaks: Literal["auto", "none"] = "auto",
    exif: Exif = "obey",
    levels: str | None = None,
    shared_frames: SharedFrames = "error",
    ground_truth: Literal["index", "none"] = "index",
) -> Dataset:
    """Return the dataset of your own images; the i-th image of every reference traverse shows place i.

    Args:
        references: a traverse or a list of traverses. A folder is read in the order of the numbers in its names.
        queries: a traverse.
        name: names the dataset in tables and records.
        tolerance: right for the i-th query are the places i - tolerance to i + tolerance.
        positives: the right places instead: a place or a list of places for each query, or a matrix (n_queries,
            n_places) of booleans or of 0 and 1, dense or a sparse one of scipy. A square matrix does not tell rows
            from columns: rows have to be queries. A query without a right place counts as a miss.
        numbers: numbers in names are decimal (0.25 before 0.5) or whole; auto: the names tell.
        breaks: auto: another folder begins another drive, where tolerance and sequences end; none: all is one drive.
        exif: obey or ignore the tag of a camera that was held on its side.
        levels: LOW..HIGH, that become 0 and 255 where files are deeper than 8 bits; None: told from all frames.
        shared_frames: error: a run whose queries are among its references is refused; allow: it has a note.
        ground_truth: none: every reference image is a place, traverses may differ in length, no answer is judged.

    Raises:
        MissingData: a folder has no images.
        BadInput: an image cannot be read, or parts do not fit one another.
    """
    choices: dict[str, Any] = {"numbers": numbers, "breaks": breaks, "exif": exif, "shared_frames": shared_frames}
    choices |= {"tolerance": as_plain(tolerance), "ground_truth": ground_truth}
    check_values("", choices, get_type_hints(dataset_of, include_extras=True))
    by_order = positives is None and ground_truth == "index"
    if tolerance and not by_order:
        raise BadInput(f"tolerance={tolerance}: leave it out with positives= and with ground_truth=none")
    if positives is not None and ground_truth == "none":
        raise BadInput("ground_truth=none: leave positives out, which say what is right")
    folders = _reader("folders")
    given = _split_traverses(references)
    traverses = [*(_read_traverse(each, "references") for each in given), _read_traverse(queries, "queries")]
    of_folders = [each for each in traverses if isinstance(each, Paths)]
    ordered, read, notes = order_by_numbers(of_folders, numbers, "numbers")
    in_order = iter(ordered)
    traverses = [next(in_order) if isinstance(each, Paths) else each for each in traverses]
    *several, query_images = traverses
    mapped = _join(several, exif, levels)
    names = [*(f"references[{number}]" for number in range(len(several))), "queries"]
    if by_order:
        folders.check_by_order(traverses, names, breaks, "", _REMEDY)
        truth = folders.match_by_order(len(several), mapped, query_images, int(tolerance), breaks)
        read = {"tolerance_places": int(tolerance), **read}
    elif ground_truth == "none":
        truth = folders.unknown(len(mapped), len(query_images))
    else:
        folders.check_by_order(several, names[:-1], breaks, "", _REMEDY)
        n_places = len(several[0])
        right = _reader("readers.positives").read_positives(positives, len(query_images), n_places)
        truth = folders.GroundTruth(np.tile(np.arange(n_places), len(several)), right, "no right place")
    protocol = {
        "protocol": "images",
        "references": [_describe_traverse(each) for each in given],
        "queries": _describe_traverse(queries),
        "ground_truth": ground_truth if positives is None else "given",
        **read,
    }
    dataset: Dataset = folders.dataset_of_files(
        name, mapped, query_images, truth, protocol, notes, unmatched="keep", breaks=breaks, exif=exif, levels=levels
    )
    return dataset.with_shared_frames(shared_frames)


def _reader(module: str) -> Any:
    """Return a module of the package that reads the dataset `folders`."""
    return registry.find_module_beside(registry.find_entries("dataset")["folders"], module)


def _split_traverses(references: Any) -> list[Any]:
    """Return each traverse of one or of a list of traverses."""
    if isinstance(references, str | Path) or not isinstance(references, Sequence) or not references:
        return [references]
    first = references[0]
    if isinstance(first, str | Path):
        return list(references) if Path(first).expanduser().is_dir() else [references]
    images = isinstance(first, np.ndarray) and (first.ndim == 2 or (first.ndim == 3 and first.shape[2] in (3, 4)))
    return [references] if images or not isinstance(first, Sequence | np.ndarray) else list(references)


def _read_traverse(traverse: Any, option: str) -> _Read:
    """Return the files or the images of one traverse; raises what `dataset_of` raises, naming the `option`."""
    if isinstance(traverse, str | Path):
        found: Paths = _reader("folders").images_in(traverse, option, "give a folder of images")
        return found
    if not isinstance(traverse, Sequence | np.ndarray):
        raise BadInput(f"{option} is of type {type(traverse).__name__}; wanted a folder, a list of images or an array")
    if not len(traverse):
        raise BadInput(f"{option} holds no image; wanted at least one (did a pattern find no file?)")
    if isinstance(traverse, np.ndarray) and traverse.ndim == 3 and traverse.shape[2] in (3, 4):
        raise BadInput(f"{option} is one image of shape {traverse.shape}; wanted several: a list of images")
    if all(isinstance(image, str | Path) for image in traverse):
        return [Path(image).expanduser() for image in traverse]
    images: list[Image] = []
    for number, image in enumerate(traverse):
        try:
            images.append(as_rgb(np.asarray(image)))
        except BadInput as error:
            raise BadInput(f"{option}, image {number}: {error}") from error
    return Images.from_arrays(images)


def _join(traverses: Sequence[_Read], exif: Exif, levels: str | None) -> Paths | Images:
    """Return traverses one after the other; files beside arrays are decoded."""
    files = Paths.of(path for each in traverses if not isinstance(each, Images) for path in each)
    if len(files) == sum(map(len, traverses)):
        return files
    decoding, _ = decoding_of(files, exif, levels)
    images: Iterator[Path | Image] = chain.from_iterable(traverses)
    return Images.from_arrays([read_image(each, decoding) if isinstance(each, Path) else each for each in images])


def _describe_traverse(traverse: Any) -> str:
    """Return the name of a traverse in records: that of its folder, or `files` or `arrays`."""
    if isinstance(traverse, str | Path):
        return Path(traverse).expanduser().resolve().name
    return "files" if isinstance(traverse[0], str | Path) else "arrays"
