"""Which image shows which place: the list that VPRTempo's authors published, and VPRSNN's own."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from pathlib import Path

from vprbench.api import BadInput, MissingData

from ..readers.traverses import every

#: When each traverse was recorded: its name in the RobotCar dataset.
RECORDINGS = {"sun": "2015-08-12-15-04-18", "rain": "2015-10-29-12-18-17", "dusk": "2014-11-21-16-07-03"}

_FOLDER = "lists"  # of VPRSNN's files, in a root
_ROWS, _STRIDE, _PLACES = 3876, 8, 450  # of VPRSNN's list: its rows, and the places that its authors take from it
_STAMP = re.compile(r"(\d{16})(\.png)?")  # microseconds, after a name that VPRSNN gave the image
_WHENCE = "copy ORC_{Sun,Rain,Dusk}_timestamps.csv from dataset_imagenames/ of https://github.com/QVPR/VPRSNN"


def published_timestamps(traverse: str) -> list[int]:
    """Return the 3369 timestamps of a traverse in place order (QVPR/VPRTempo 64154e5), repeated where a frame is."""
    return [int(row) for row in Path(__file__).with_name(f"oxford_{traverse}.csv").read_text("ascii").split()]


def lists_folder(given: str | None, roots: Sequence[Path]) -> Path:
    """Return the folder of VPRSNN's lists: `given`, or else the first of its name in `roots`.

    Raises MissingData if there is none.
    """
    candidates = [root / _FOLDER for root in roots] if given is None else [Path(given).expanduser()]
    found = next(filter(Path.is_dir, candidates), None)
    if found is None:
        raise MissingData(
            f"VPRSNN's image lists are not there ({' and '.join(map(str, candidates))}): {_WHENCE} to {candidates[0]}, "
            "or set dataset.lists to the folder that holds them"
        )
    return found


def vprsnn_timestamps(folder: Path, traverse: str) -> list[int]:
    """Return the 3876 timestamps of a traverse in place order, as VPRSNN's authors list them (QVPR/VPRSNN d38f30c).

    Of the file's columns the column with the cameras' own names counts, with or without `.png`; lines before the first
    such name are its head. Raises MissingData if the file is missing, BadInput for another list.
    """
    path = folder / f"ORC_{traverse.capitalize()}_timestamps.csv"
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = [(number, row) for number, row in enumerate(csv.reader(file), 1) if any(map(str.strip, row))]
    except FileNotFoundError as error:
        raise MissingData(f"{path} does not exist: {_WHENCE} to {folder}") from error
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise BadInput(f"{path} cannot be read as a list ({error}): {_WHENCE}") from error
    stamps = _stamps(path, rows)
    if len(stamps) != _ROWS:
        raise BadInput(f"{path} lists {len(stamps)} images; VPRSNN's list has {_ROWS}: {_WHENCE}")
    distinct = len(set(every(stamps, _STRIDE, _PLACES)))
    if distinct != _PLACES:
        raise BadInput(
            f"{path} is not VPRSNN's list: every {_STRIDE}th row names {distinct} distinct images among the first "
            f"{_PLACES}, and all have to be distinct; {_WHENCE}"
        )
    return stamps


def _stamps(path: Path, rows: Sequence[tuple[int, list[str]]]) -> list[int]:
    """Return the timestamps of numbered rows from the first column that holds one."""
    stamps: list[int] = []
    column: int | None = None
    for number, row in rows:
        cells = [_STAMP.fullmatch(cell.strip()) for cell in row]
        if column is None:
            column = next((i for i, cell in enumerate(cells) if cell), None)
        if column is None:
            continue
        found = cells[column] if column < len(cells) else None
        if found is None:
            raise BadInput(f"{path}, line {number}: {','.join(row)[:80]} names no image by its timestamp: {_WHENCE}")
        stamps.append(int(found[1]))
    return stamps
