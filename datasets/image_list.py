"""Lists of images in CSV files, one row an image, with its place or its position."""

from __future__ import annotations

import re
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from vprbench.api import BadInput, Dataset, Exif, NotThere, Paths

from .readers.csv_tables import read_csv
from .readers.drives import Breaks
from .readers.file_dataset import GroundTruth, Unmatched, dataset_of_files, unknown
from .readers.image_files import find_listed
from .readers.positions import MOST_METRES, by_radius, earth_centred
from .readers.traverses import right_places

Kind = Literal["place", "east_north", "lat_lon"]

_COLUMNS: dict[Kind, tuple[str, ...]] = {
    "place": ("place",),
    "east_north": ("east", "north"),
    "lat_lon": ("lat", "lon"),
}
_ALIASES = {"image name": "image", "index": "place"}  # as QVPR/VPRTempo names them
_WHOLE = re.compile(r"(-?\d+)\.0+")  # a whole number as a program writes it that takes all numbers for decimal ones
_KNOWN = ("image", *(column for columns in _COLUMNS.values() for column in columns))
_WANTED = "image, and place or east,north or lat,lon"


def image_list(
    name: str = "image_list",
    references: list[str] | None = None,
    queries: str | None = None,
    root: str | None = None,
    tolerance: int = 0,
    radius_metres: float = 25.0,
    unmatched: Unmatched = "error",
    breaks: Breaks = "auto",
    exif: Exif = "obey",
    levels: str | None = None,
    ground_truth: Literal["columns", "none"] = "columns",
) -> Dataset:
    """Return the images that CSV files list, in the order of their rows.

    The columns are `image`, a path from `root` (from the folder of the CSV if None), and the first of `place`,
    `east,north` (metres of one grid) and `lat,lon` (degrees, WGS 84) that all files have. VPRTempo's header
    `Image name,index` is read as image and place.

    Places are any numbers or words. They are numbered in the order in which the references first name them, several
    references may show one, and right are places at most `tolerance` away in that numbering. By position every
    reference is a place, and right is what lies within `radius_metres`, the radius included; the distance between
    latitudes and longitudes is the straight line through the ellipsoid. Another folder, or a position that jumps,
    begins another drive unless `breaks` is none.

    `exif` and `levels` say how files are decoded (`decoding_of`).

    With `ground_truth` none the column `image` is enough: every reference is a place, and no answer is judged.

    Raises NotThere for missing files, BadInput for tables that do not fit.
    """
    if not references or queries is None:
        raise NotThere(
            "dataset.references and dataset.queries are not set: "
            "pass dataset.references=[/path/to/first.csv,/path/to/second.csv] dataset.queries=/path/to/queries.csv"
        )
    files = [*(Path(file).expanduser() for file in references), Path(queries).expanduser()]
    tables = [_table(file, root) for file in files]
    mapped, asked = tables[:-1], tables[-1]
    kind = "none" if ground_truth == "none" else _kind_of_all(tables)
    chosen = {"tolerance_places": tolerance} if kind == "place" else {"radius_metres": radius_metres}
    if kind == "none":
        truth, chosen = unknown(sum(len(table.images) for table in mapped), len(asked.images)), {}
    elif kind == "place":
        truth = _by_place([label for table in mapped for label in table.labels()], asked.labels(), tolerance)
    else:
        known = np.concatenate([table.positions(kind) for table in mapped])
        truth = by_radius(known, asked.positions(kind), radius_metres)
    return dataset_of_files(
        name,
        Paths.joined(table.images for table in mapped),
        asked.images,
        truth,
        unmatched,
        {
            "protocol": "image_list",
            "references": [file.name for file in files[:-1]],
            "queries": files[-1].name,
            "ground_truth": kind,
            **chosen,
        },
        breaks=breaks,
        exif=exif,
        levels=levels,
    )


@dataclass(frozen=True)
class _Table:
    """The rows of one CSV."""

    file: Path
    images: Paths
    cells: Mapping[str, Sequence[str]]  # of every row, by our names of the columns

    def labels(self) -> list[str | int]:
        """Return the place of every row, whole numbers as such: 7, 007 and 7.0 are one place."""
        words = [whole[1] if (whole := _WHOLE.fullmatch(word)) else word for word in self._words("place")]
        return [int(word) if len(word) < 20 and word.removeprefix("-").isdecimal() else word for word in words]

    def positions(self, kind: Kind) -> npt.NDArray[np.float64]:
        """Return the position of every row, (n, 2) or (n, 3)."""
        first, second = (self._numbers(column) for column in _COLUMNS[kind])
        return earth_centred(first, second) if kind == "lat_lon" else np.stack([first, second], axis=1)

    def _numbers(self, column: str) -> npt.NDArray[np.float64]:
        most = {"lat": 90.0, "lon": 180.0}.get(column, MOST_METRES)
        numbers = array("d")
        for word in self._words(column):
            try:
                number = float(word)
            except ValueError:
                number = np.nan
            if not abs(number) <= most:
                row = len(numbers) + 1
                point = ", decimals with a point" * ("," in word)
                raise BadInput(f"{column} {word} in row {row} of {self.file}: wanted is -{most:g} to {most:g}{point}")
            numbers.append(number)
        return np.array(numbers)

    def _words(self, column: str) -> list[str]:
        words = [word.strip() for word in self.cells[column]]
        if "" in words:
            raise BadInput(f"row {words.index('') + 1} of {self.file} has no {column}: every row needs one")
        return words


def _table(file: Path, root: str | None) -> _Table:
    """Read a CSV and check that its images are there."""
    if not file.is_file():
        raise NotThere(f"{file} is no file: give a CSV with the columns {_WANTED}")
    table = read_csv(file, _WANTED)
    plain = [column.strip().lower() for column in table.header]
    columns = [_ALIASES.get(column, column) for column in plain]
    if "image" not in columns or any(columns.count(name) > 1 for name in _KNOWN):
        raise BadInput(f"{file} has the columns {table.described_columns}; wanted are {_WANTED}, each once")
    if not table.lines:
        raise BadInput(f"{file} lists no image: give it a row for each")
    cells = dict(zip(columns, table.columns, strict=True))
    names = _Table(file, Paths.of([]), cells)._words("image")
    named = Paths.below(file.parent if root is None else Path(root).expanduser(), names)
    images = find_listed(named, file.name, "correct the paths, or set dataset.root to the folder that they start from")
    return _Table(file, images, {**cells, "image": ()})  # the images hold them in less memory


def _kind_of_all(tables: Sequence[_Table]) -> Kind:
    """Return the first kind of ground truth that all tables hold; raises BadInput if no kind is common to all."""
    for kind, columns in _COLUMNS.items():
        if all({*columns} <= {*table.cells} for table in tables):
            return kind
    held = "; ".join(f"{table.file.name} has {', '.join(table.cells)}" for table in tables)
    raise BadInput(f"{held}: wanted are {_WANTED}, the same in all files, or dataset.ground_truth=none")


def _by_place(references: list[str | int], queries: list[str | int], tolerance: int) -> GroundTruth:
    """Number the places as the references first name them; right for a query are the places around its own."""
    numbers = {label: number for number, label in enumerate(dict.fromkeys(references))}
    nowhere = -2 * len(numbers)  # further from every place than the tolerance can reach
    asked = np.array([numbers.get(label, nowhere) for label in queries])
    return GroundTruth(
        places=np.array([numbers[label] for label in references]),
        positives=right_places(asked, np.arange(len(numbers)), tolerance),
        lacking="a place that no reference shows",
    )
