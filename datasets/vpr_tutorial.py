"""Gardens Point, St Lucia (small) and SFU Mountain as VPR_Tutorial has them, with its hard or soft ground truth."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, Unpack

import numpy as np

from vprbench.api import BadInput, Dataset, MissingData, Paths

from .readers.file_dataset import FileOptions, GroundTruth, dataset_of_files, make_ground_truth
from .readers.frame_folders import find_folder, find_root
from .readers.image_files import images_in
from .readers.positives import read_matrix_file
from .readers.traverses import check_references, match_numbers

Strictness = Literal["hard", "soft"]

_SOFT_BAND = 8  # places to either side: 17 rows (stschubert/VPR_Tutorial 2278d7e)
_MATRICES = {"hard": "GThard", "soft": "GTsoft"}


def gardens_point(
    name: str = "gardens_point",
    root: str | None = None,
    references: list[str] | None = None,
    query: str = "night_right",
    images: int = 200,
    ground_truth: Strictness = "hard",
    tolerance: int | None = None,
    **options: Unpack[FileOptions],
) -> Dataset:
    """Return the first `images` images of every traverse, in natural order; the i-th of each shows place i.

    `references` are the folders of the map (day_right if None). Right is the place of the same number; with `soft` also
    the 8 to either side. A `tolerance` in places stands in for both. Raises MissingData for missing folders or
    images.
    """
    traverses = ["day_right"] if references is None else references
    check_references(traverses, "folder")
    if images < 1:
        raise BadInput(f"dataset.images={images}: give 1 or more")
    reach = (0 if ground_truth == "hard" else _SOFT_BAND) if tolerance is None else tolerance
    places = np.arange(images)
    right = match_numbers(places, places, reach)
    layout = (
        "run python -m vprbench fetch gardens_point, or get GardensPoint_Walking.zip from "
        "www.tu-chemnitz.de/etit/proaut/datasets (all frames: doi 10.5281/zenodo.4590133) and "
        f"set dataset.root to the folder that holds {', '.join([*traverses, query])}"
    )
    top = find_root(name, root, "the traverses", layout, parts=[*traverses, query])
    map_files = Paths.joined(_take_first(find_folder(top, traverse), images, layout) for traverse in traverses)
    return dataset_of_files(
        name,
        map_files,
        _take_first(find_folder(top, query), images, layout),
        GroundTruth(np.tile(places, len(traverses)), right, "no reference", by_order=True),
        {
            "protocol": "vpr_tutorial",
            "references": traverses,
            "query": query,
            "images": images,
            "ground_truth": ground_truth if tolerance is None else "tolerance",
            "tolerance_places": reach,
        },
        **(FileOptions(unmatched="error") | options),
    )


def with_matrix(
    name: str,
    root: str | None = None,
    reference: str = "",
    query: str = "",
    ground_truth: Strictness = "hard",
    source: str = "",
    **options: Unpack[FileOptions],
) -> Dataset:
    """Return two folders of images, in the order of their paths, with the matrix GThard or GTsoft of GT.npz.

    Every reference is a place. The matrix is (n_references, n_queries), true if both show the same place. Queries
    without any are left out, as VPR_Tutorial's recall does, unless `unmatched` is given. `source` says in messages
    where the data are to be had. Raises MissingData for what is missing, BadInput for a matrix that does not fit.
    """
    layout = f"{source} and set dataset.root to the folder that holds {reference}, {query} and GT.npz"
    top = find_root(name, root, f"{reference}, {query} and GT.npz", layout, parts=[reference, query])
    map_files, query_files = (
        images_in(find_folder(top, folder), "dataset.root", layout, order="plain", deep=False)
        for folder in (reference, query)
    )
    shape, axes = (len(map_files), len(query_files)), ("references", "queries")
    right = read_matrix_file(top / "GT.npz", _MATRICES[ground_truth], shape, axes, layout, of_columns=True)
    return dataset_of_files(
        name,
        map_files,
        query_files,
        make_ground_truth(len(map_files), right, f"no right reference in {_MATRICES[ground_truth]}"),
        {"protocol": "vpr_tutorial", "reference": reference, "query": query, "ground_truth": ground_truth},
        **(FileOptions(unmatched="drop") | options),
    )


def _take_first(folder: Path, count: int, layout: str) -> Paths:
    """Return the first images of a folder; raises MissingData if there are fewer."""
    files = images_in(folder, "dataset.root", layout, deep=False)
    if len(files) < count:
        raise MissingData(
            f"{folder} holds {len(files)} of {count} images: restore the others, or pass dataset.images={len(files)} "
            "for the first of them"
        )
    return files[:count]
