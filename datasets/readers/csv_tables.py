"""Tables in CSV files, of a bounded number of columns."""

from __future__ import annotations

import codecs
import csv
import re
from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from vprbench.api import BadInput

_MOST_COLUMNS = 1000
_SHOWN = 10  # columns in a message
_LONGEST_HEADER = 1 << 20  # characters
_DECIMAL = re.compile(r"\s*[-+]?\d*(,\d+)?\s*")
_THOUSANDS = re.compile(r"\s*[-+]?\d{1,3},\d{3}\s*")


@dataclass(frozen=True)
class CsvTable:
    """The cells of a CSV file, all of them text."""

    header: list[str]
    columns: list[list[str]]  # each as long as there are rows; blank lines are none
    lines: Sequence[int]  # of each row, the line of the file that it ends in, from 1

    def column(self, name: str) -> list[str]:
        """Return the cells of the first column of a name in the header."""
        return self.columns[self.header.index(name)]

    @property
    def described_columns(self) -> str:
        """The columns, for a message."""
        more = f" and {len(self.header) - _SHOWN} more" if len(self.header) > _SHOWN else ""
        return (", ".join(self.header[:_SHOWN]) or "none") + more


def read_csv(file: Path, wanted: str) -> CsvTable:
    """Read a CSV file whose first row is its header; raises BadInput, with `wanted`, for any other file.

    Its text is UTF-8 or UTF-16, and its cells stand between commas. Where the header has none they stand between
    semicolons or tabs, and decimal commas are points. A line `sep=;` above the header names another sign.
    """
    lines = array("q")
    try:
        with file.open(newline="", encoding=encoding_of(file)) as text:
            separator, above = _separator(text)
            reader = csv.reader(text, strict=True, delimiter=separator)
            header = next(filter(None, reader), [])
            if len(header) > _MOST_COLUMNS:
                raise BadInput(f"{file} has {len(header)} columns, more than {_MOST_COLUMNS}: wanted are {wanted}")
            columns: list[list[str]] = [[] for _ in header]
            for row in filter(None, reader):
                line = reader.line_num + above
                if len(row) != len(header):
                    few = "fewer" if len(row) < len(header) else "more"
                    raise BadInput(
                        f"line {line} of {file} has {few} cells than its header: give it one for every "
                        "column, put text that holds a comma in quotes, and write decimals with a point"
                    )
                for column, cell in zip(columns, row, strict=True):
                    column.append(cell)
                lines.append(line)
    except (UnicodeError, csv.Error) as error:
        advice = f"save it in UTF-8, with the columns {wanted}"
        raise BadInput(f"{file} cannot be read as a CSV ({error}): {advice}") from error
    except OSError as error:
        raise BadInput(f"{file} cannot be read ({error.strerror}): wanted is a CSV with {wanted}") from error
    return CsvTable(header, columns if separator == "," else [*map(_with_points, columns)], lines)


def encoding_of(file: Path) -> str:
    """Return the encoding of a text whose first character is of ASCII: UTF-8, or UTF-16 as Excel and Notepad write."""
    with file.open("rb") as raw:
        start = raw.read(4)
    if start.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    if start[:1] == b"\0":
        return "utf-16-be"
    return "utf-16-le" if start[1:2] == b"\0" else "utf-8-sig"


def _separator(text: TextIO) -> tuple[str, int]:
    """Return what stands between the cells of a CSV, and how many lines that said so were read."""
    first = text.readline(_LONGEST_HEADER)
    if said := re.fullmatch(r'"?sep=(.)"?[,;\t]*\s*', first, re.IGNORECASE):
        return said[1], 1
    text.seek(0)
    return next((sign for sign in ",;\t" if sign in first), ","), 0


def _with_points(cells: list[str]) -> list[str]:
    """Return numbers with decimal points for their commas, unless these may stand between thousands."""
    commas = [cell for cell in cells if "," in cell]
    if not all(_DECIMAL.fullmatch(cell) for cell in cells) or all(map(_THOUSANDS.fullmatch, commas)):
        return cells
    return [cell.replace(",", ".") for cell in cells]
