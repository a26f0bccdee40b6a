"""Your own frames: folders of reference and query images, matched by their order or by positions in their names."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt
from natsort import natsorted
from scipy.spatial import KDTree

from vprbench.images import Images
from vprbench.interface import BadInput, Dataset, NotThere

_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".ppm", ".pgm")


def folders(
    name: str = "folders",
    references: list[str] | None = None,
    queries: str | None = None,
    ground_truth: Literal["index", "utm"] = "index",
    tolerance: int = 0,
    radius_metres: float = 25.0,
    unmatched: Literal["error", "keep"] = "error",
) -> Dataset:
    """Return the images of your own folders in natural order (2.jpg before 10.jpg), sub-folders included.

    With `index` the i-th image of every reference folder (a traverse each) shows place i, and right for the i-th
    query are the places i - tolerance to i + tolerance. With `utm` every reference image is a place, names are
    `@UTM_east@UTM_north@...` in metres of one zone, and right is what lies within `radius_metres`, the radius
    included. A query without a right place is an error, or kept as a miss. Raises NotThere for folders that are missing
    or hold no images, BadInput for bad names and arguments.
    """
    if not references or queries is None:
        raise NotThere(
            "dataset.references and dataset.queries are not set: "
            "pass dataset.references=[/path/to/first,/path/to/second] dataset.queries=/path/to/queries"
        )
    traverses = [_image_files(folder, "dataset.references") for folder in references]
    asked = _image_files(queries, "dataset.queries")
    if ground_truth == "index":
        places, positives = _by_index(traverses, references, len(asked), tolerance)
    else:
        places, positives = _by_position([path for files in traverses for path in files], asked, radius_metres)
    without = [i for i, right in enumerate(positives) if len(right) == 0]
    if without and unmatched == "error":
        reach = f"{tolerance} places" if ground_truth == "index" else f"{radius_metres:g} m"
        raise BadInput(
            f"{len(without)} of {len(asked)} queries have no reference within {reach} (first: {asked[without[0]]}): "
            "correct the data, or pass dataset.unmatched=keep to count them as misses"
        )
    chosen = {"tolerance_places": tolerance} if ground_truth == "index" else {"radius_metres": radius_metres}
    return Dataset(
        name=name,
        references=Images.from_files([path for files in traverses for path in files]),
        places=places,
        queries=Images.from_files(asked),
        positives=tuple(positives),
        protocol={
            "references": [Path(folder).resolve().name for folder in references],
            "queries": Path(queries).resolve().name,
            "ground_truth": ground_truth,
            "unmatched": unmatched,
            **chosen,
        },
    )


def _image_files(folder: str, option: str) -> list[Path]:
    """Return the image files below a folder in natural order; raises NotThere where there are none."""
    top = Path(folder).expanduser()
    if not folder or not top.is_dir():
        raise NotThere(f"{option}: {folder or 'nothing'} is no folder")
    files = [path for path in top.rglob("*") if path.suffix.lower() in _SUFFIXES and path.is_file()]
    if not files:
        raise NotThere(f"{option}: {folder} holds no images ({', '.join(_SUFFIXES)})")
    # Sorted first, so that names which count as equal (1.png, 01.png) have an order too.
    return [Path(path) for path in natsorted(sorted(files))]


def _by_index(
    traverses: list[list[Path]], names: list[str], n_queries: int, tolerance: int
) -> tuple[npt.NDArray[np.int64], list[npt.NDArray[np.int64]]]:
    """Return the place of every reference and the right places of every query, by their number in the traverse."""
    if tolerance < 0:
        raise BadInput(f"dataset.tolerance={tolerance}: give 0 or more places")
    counts = {len(files) for files in traverses}
    if len(counts) > 1:
        listed = ", ".join(f"{name} {len(files)}" for name, files in zip(names, traverses, strict=True))
        raise BadInput(
            f"dataset.references hold different numbers of images ({listed}): with ground_truth=index the i-th image "
            "of every folder has to show the same place"
        )
    n_places = counts.pop()
    positives = [
        np.arange(max(0, query - tolerance), min(n_places, query + tolerance + 1)) for query in range(n_queries)
    ]
    return np.tile(np.arange(n_places), len(traverses)), positives


def _by_position(
    references: list[Path], queries: list[Path], radius: float
) -> tuple[npt.NDArray[np.int64], list[npt.NDArray[np.int64]]]:
    """Return one place per reference, and for every query the references at most `radius` metres away."""
    if radius <= 0:
        raise BadInput(f"dataset.radius_metres={radius:g}: give more than 0 metres")
    tree = KDTree(np.array([_position(path) for path in references]))
    near = tree.query_ball_point(np.array([_position(path) for path in queries]), radius, return_sorted=True)
    return np.arange(len(references)), [np.array(found, dtype=np.int64) for found in near]


def _position(path: Path) -> tuple[float, float]:
    """Return easting and northing in metres from a file name `@east@north@...`; raises BadInput with the name."""
    parts = path.name.split("@")
    try:
        east, north = float(parts[1]), float(parts[2])
    except (IndexError, ValueError) as error:
        raise BadInput(
            f"{path} names no position: with ground_truth=utm a name has to begin with @UTM_east@UTM_north@"
        ) from error
    if not (np.isfinite(east) and np.isfinite(north)):
        raise BadInput(f"{path} names the position {east}, {north}: finite metres are wanted")
    return east, north
