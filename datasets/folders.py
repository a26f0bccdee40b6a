"""Your own frames: folders of reference and query images, matched by order, by positions in names or by a matrix."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Unpack

import numpy as np

from vprbench.api import BadInput, Dataset, Images, MissingData, NumberReading, Paths, order_by_numbers

from .readers.drives import Breaks, check_by_order, find_drives, keep_in_drive
from .readers.file_dataset import OWN_FILES, FileOptions, GroundTruth, dataset_of_files, make_ground_truth, unknown
from .readers.image_files import images_in
from .readers.positions import Positions, WithoutPosition, match_positions, require_metres
from .readers.positives import load_arrays, read_matrix_file
from .readers.traverses import match_numbers
from .readers.utm_names import match_names

_ADVICE = "give a folder of images"
_MATRIX = "positives"
_WANTED = f"the matrix {_MATRIX}, or the positions utmQ and utmDb"  # and the radius posDistThr, as in dbStruct files
_ADVICE_FILE = f"dataset.ground_truth wants {_WANTED}"
_WAYS_OUT = (
    "give as many in each, or say what is right by dataset.ground_truth=utm (positions in names), by "
    f"dataset.ground_truth=FILE.npz ({_WANTED}) or by dataset=image_list (a column place)"
)


def folders(
    name: str = "folders",
    references: list[str] | None = None,
    queries: str | None = None,
    ground_truth: str = "index",
    tolerance: int = 0,
    radius_metres: float = 25.0,
    numbers: NumberReading = "auto",
    without_position: WithoutPosition = "error",
    **options: Unpack[FileOptions],
) -> Dataset:
    """Return the images of your own folders in natural order (2.jpg before 10.jpg), sub-folders included.

    `numbers` says whether numbers in names are decimal (0.25 before 0.5) or whole; by default the names tell.
    Tolerance ends where a drive ends. Options that are not given are those of your own files (`OWN_FILES`).

    With `index` the i-th image of every reference folder (a traverse each) shows place i, and right for the i-th
    query are the places i - tolerance to i + tolerance. With `utm` every reference image is a place, names are
    `@UTM_east@UTM_north@...` in metres of one zone, and right is what lies within `radius_metres`, the radius
    included. With an .npz file every reference image is a place, and right is what its matrix `positives`,
    (n_queries, n_references), says, or what lies within the radius by its `utmQ` and `utmDb`, (n, 2) metres. With
    `none` every reference image is a place, nobody knows which are right, and no answer is judged.
    `without_position` is that of `match_positions`. Raises MissingData for folders that are missing or hold no images,
    BadInput for bad names, arguments and matrices.
    """
    if not references or queries is None:
        raise MissingData(
            "dataset.references and dataset.queries are not set: "
            "pass dataset.references=[/path/to/first,/path/to/second] dataset.queries=/path/to/queries"
        )
    found = [images_in(folder, "dataset.references", _ADVICE) for folder in references]
    found.append(images_in(queries, "dataset.queries", _ADVICE))
    (*traverses, query_files), read, notes = order_by_numbers(found, numbers)
    map_files = Paths.joined(traverses)
    options = OWN_FILES | options
    breaks = options["breaks"]
    chosen: dict[str, float] = {}
    if ground_truth == "index":
        check_by_order(found, [*references, queries], breaks, "dataset.", _WAYS_OUT)
        truth = match_by_order(len(references), map_files, query_files, tolerance, breaks)
        chosen = {"tolerance_places": tolerance}
    elif ground_truth == "utm":
        chosen = {"radius_metres": radius_metres}
        truth = match_names(map_files, query_files, radius_metres, without=without_position)
    elif ground_truth == "none":
        truth = unknown(len(map_files), len(query_files))
    else:
        truth, chosen = _read_truth(
            Path(ground_truth).expanduser(), map_files, query_files, radius_metres, without_position
        )
    return dataset_of_files(
        name,
        map_files,
        query_files,
        truth,
        {
            "protocol": "folders",
            "references": [Path(folder).resolve().name for folder in references],
            "queries": Path(queries).resolve().name,
            "ground_truth": Path(ground_truth).name,
            **chosen,
            **read,
        },
        notes,
        **options,
    )


def match_by_order(
    n_traverses: int,
    references: Sequence[Path] | Images,
    queries: Sequence[Path] | Images,
    tolerance: int,
    breaks: Breaks,
) -> GroundTruth:
    """Return the ground truth by index within the drive of each query; traverses of one length follow in turn."""
    truth = match_indices(n_traverses, len(references) // n_traverses, len(queries), tolerance)
    starts = find_drives(references, queries, breaks)
    drives = np.union1d(starts.find_place_starts(truth.places), starts.queries)
    return replace(truth, positives=keep_in_drive(truth.positives, drives))


def match_indices(n_traverses: int, n_places: int, n_queries: int, tolerance: int) -> GroundTruth:
    """Return the place of every reference and the right places of every query, by their number in the traverse."""
    places = np.arange(n_places)
    positives = match_numbers(np.arange(n_queries), places, tolerance)
    lacking = f"no reference within {tolerance} places"
    return GroundTruth(np.tile(places, n_traverses), positives, lacking, by_order=True)


def _read_truth(
    file: Path, references: Paths, queries: Paths, radius_metres: float, without: WithoutPosition
) -> tuple[GroundTruth, dict[str, float]]:
    """Return the ground truth of an .npz file of all images, and the radius where positions decide."""
    if file.suffix != ".npz":
        raise BadInput(f"dataset.ground_truth={file}: give index, utm, none or an .npz file with {_WANTED}")
    n_queries, n_references = len(queries), len(references)
    most = {_MATRIX: n_queries * n_references, "utmQ": 2 * n_queries, "utmDb": 2 * n_references, "posDistThr": 1}
    wanted = f"the matrix {_MATRIX}, {n_queries} queries by {n_references} references, or the positions utmQ and utmDb"
    arrays = load_arrays(file, most, wanted, _ADVICE_FILE)
    if not {"utmQ", "utmDb"} <= {*arrays}:
        shape, axes = (n_queries, n_references), ("queries", "references")
        right = read_matrix_file(file, _MATRIX, shape, axes, _ADVICE_FILE)
        return make_ground_truth(n_references, right, f"no right reference in {file.name}"), {}
    query_positions, map_positions = (
        Positions(files, require_metres(f"{key} in {file}", arrays[key], len(files)))
        for key, files in (("utmQ", queries), ("utmDb", references))
    )
    truth = match_positions([map_positions], query_positions, radius_metres, without)
    own = arrays.get("posDistThr", np.array(radius_metres))
    if own.size == 1 and own.dtype.kind in "fiu" and own.item() != radius_metres:
        note = f"{file.name} is for a radius of {own.item():g} m; dataset.radius_metres={radius_metres:g} counts"
        truth = replace(truth, notes=(*truth.notes, note))
    return truth, {"radius_metres": radius_metres}
