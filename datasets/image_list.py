"""Lists of images in CSV files, one row an image, with its place or its position."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Unpack

import numpy as np
import numpy.typing as npt

from vprbench.api import BadInput, Dataset, MissingData, Paths

from .readers.csv_tables import read_csv
from .readers.file_dataset import OWN_FILES, FileOptions, GroundTruth, dataset_of_files, unknown
from .readers.image_files import find_listed
from .readers.positions import MOST_METRES, Positions, WithoutPosition, match_positions
from .readers.traverses import match_numbers

if TYPE_CHECKING:
    import pandas as pd

Kind = Literal["place", "east_north", "lat_lon"]
Label = str | int  # of a place

_COLUMNS: dict[Kind, list[str]] = {"place": ["place"], "east_north": ["east", "north"], "lat_lon": ["lat", "lon"]}
_ALIASES = {"image name": "image", "index": "place"}  # as QVPR/VPRTempo names them
_WHOLE = re.compile(r"(-?\d{1,19})(?:\.0+)?")  # a whole number, as a program may write it that takes all for decimal
_MOST_PLACES = 2**61  # of which sums are 64-bit numbers; times in nanoseconds are below
_KNOWN = ["image", *(column for columns in _COLUMNS.values() for column in columns)]
_WANTED = "image, and place or east,north or lat,lon"


def image_list(
    name: str = "image_list",
    references: list[str] | None = None,
    queries: str | None = None,
    root: str | None = None,
    tolerance: int = 0,
    radius_metres: float = 25.0,
    ground_truth: Literal["columns", "none"] = "columns",
    without_position: WithoutPosition = "error",
    **options: Unpack[FileOptions],
) -> Dataset:
    """Return the images that CSV files list, in the order of their rows.

    The columns are `image`, a path from `root` (from the folder of the CSV if None), and the first of `place`,
    `east,north` (metres of one grid) and `lat,lon` (degrees, WGS 84) that all files have. VPRTempo's header
    `Image name,index` is read as image and place.

    Places are any numbers or words, several references may show one, and right are places at most `tolerance` away.
    Whole numbers count as themselves: 8 is 8 places from 0. Words are numbered in the order in which the references
    first name them, whole numbers too if any place is a word. By position every reference is a place, and right is what
    lies within `radius_metres`, the radius included; the distance between latitudes and longitudes is the straight line
    through the ellipsoid. With `ground_truth` none the column `image` is enough: every reference is a place, and no
    answer is judged. `without_position` is that of `match_positions`. Options that are not given are those of your own
    files (`OWN_FILES`).

    Raises MissingData for missing files, BadInput for tables that do not fit.
    """
    if not references or queries is None:
        raise MissingData(
            "dataset.references and dataset.queries are not set: "
            "pass dataset.references=[/path/to/first.csv,/path/to/second.csv] dataset.queries=/path/to/queries.csv"
        )
    files = [*(Path(file).expanduser() for file in references), Path(queries).expanduser()]
    tables = [_read_table(file, root) for file in files]
    map_tables, query_table = tables[:-1], tables[-1]
    kind = "none" if ground_truth == "none" else _find_kind(tables)
    chosen: dict[str, float] = {}
    if kind == "none":
        truth = unknown(sum(len(table.images) for table in map_tables), len(query_table.images))
    elif kind == "place":
        shown = [label for table in map_tables for label in table.read_labels()]
        truth = _match_labels(shown, query_table.read_labels(), tolerance)
        chosen = {"tolerance_places": tolerance}
    else:
        *known, sought = (table.read_positions(kind, without_position) for table in tables)
        truth = match_positions(known, sought, radius_metres, without_position)
        chosen = {"radius_metres": radius_metres}
    return dataset_of_files(
        name,
        Paths.joined(table.images for table in map_tables),
        query_table.images,
        truth,
        {
            "protocol": "image_list",
            "references": [file.name for file in files[:-1]],
            "queries": files[-1].name,
            "ground_truth": kind,
            **chosen,
        },
        **(OWN_FILES | options),
    )


@dataclass(frozen=True)
class _Table:
    """The rows of one CSV."""

    file: Path
    images: Paths
    cells: pd.DataFrame  # text, by our names of the columns

    def read_labels(self) -> list[Label]:
        """Return the place of every row, whole numbers as such: 7, 007 and 7.0 are one place."""
        words = _require_words(self.file, self.cells, "place")
        return [int(whole[1]) if (whole := _WHOLE.fullmatch(word)) else word for word in words]

    def read_positions(self, kind: Kind, without: WithoutPosition) -> Positions:
        """Return the position of every row; numbers that are none are an error, or NaN where such rows are left out."""
        given = np.stack([self._read_numbers(column, without) for column in _COLUMNS[kind]], axis=1)
        return Positions(self.images, given, in_degrees=kind == "lat_lon")

    def _read_numbers(self, column: str, without: WithoutPosition) -> npt.NDArray[np.float64]:
        import pandas as pd

        numbers: npt.NDArray[np.float64] = pd.to_numeric(self.cells[column], errors="coerce").to_numpy(np.float64)
        most = {"lat": 90.0, "lon": 180.0}.get(column, MOST_METRES)
        wrong = ~(np.abs(numbers) <= most)
        if wrong.any() and without != "drop":
            word = self.cells[column][row := int(wrong.argmax())]
            point = ", decimals with a point" * ("," in word)
            raise BadInput(
                f"{column} {word} in row {row + 1} of {self.file}: wanted is -{most:g} to {most:g}{point}; "
                "dataset.without_position=drop leaves such rows out"
            )
        return np.where(wrong, np.nan, numbers)


def _read_table(file: Path, root: str | None) -> _Table:
    """Read a CSV and check that its images are there."""
    if not file.is_file():
        raise MissingData(f"{file} is no file: give a CSV with the columns {_WANTED}")
    cells = read_csv(file, _WANTED).rename(columns=_ALIASES)
    columns = [*cells.columns]
    if "image" not in columns or any(columns.count(name) > 1 for name in _KNOWN):
        raise BadInput(f"{file} has the columns {', '.join(columns)}; wanted are {_WANTED}, each once")
    if cells.empty:
        raise BadInput(f"{file} lists no image: give it a row for each")
    words = _require_words(file, cells, "image")
    named = Paths.below(file.parent if root is None else Path(root).expanduser(), words)
    images = find_listed(named, file.name, "correct the paths, or set dataset.root to the folder that they start from")
    return _Table(file, images, cells)


def _require_words(file: Path, cells: pd.DataFrame, column: str) -> list[str]:
    """Return the cells of a column; raises BadInput where one is empty."""
    words: list[str] = cells[column].str.strip().tolist()
    if "" in words:
        raise BadInput(f"row {words.index('') + 1} of {file} has no {column}: every row needs one")
    return words


def _find_kind(tables: Sequence[_Table]) -> Kind:
    """Return the first kind of ground truth that all tables hold; raises BadInput if no kind is common to all."""
    for kind, columns in _COLUMNS.items():
        if all({*columns} <= {*table.cells} for table in tables):
            return kind
    held = "; ".join(f"{table.file.name} has {', '.join(table.cells.columns)}" for table in tables)
    raise BadInput(f"{held}: wanted are {_WANTED}, the same in all files, or dataset.ground_truth=none")


def _match_labels(references: list[Label], queries: list[Label], tolerance: int) -> GroundTruth:
    """Return the ground truth of places by their labels.

    Whole numbers lie where they say; other labels in the order in which the references first name them.
    """
    at: dict[Label, int] = {label: row for row, label in enumerate(dict.fromkeys(references))}
    are_numbers = all(map(_is_number, references))
    if are_numbers:
        at = {label: int(label) for label in (*references, *queries) if _is_number(label)}
    first = min(at.values())
    nowhere = first - max(at.values()) - 1  # further from every place than the tolerance can reach
    journey, places = np.unique([at[label] for label in references], return_inverse=True)
    sought = np.array([at[label] - first if label in at else nowhere for label in queries])
    positives = match_numbers(sought, journey - first, tolerance)
    numbers = journey if are_numbers and not np.array_equal(journey, np.arange(len(journey))) else None
    return GroundTruth(places, positives, "a place that no reference shows", place_numbers=numbers)


def _is_number(label: Label) -> bool:
    return isinstance(label, int) and abs(label) < _MOST_PLACES
