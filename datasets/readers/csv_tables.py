"""Tables in CSV files, of a bounded number of columns."""

from __future__ import annotations

import csv
from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from vprbench.api import BadInput

_MOST_COLUMNS = 1000
_SHOWN = 10  # columns in a message


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
    """Read a CSV file in UTF-8 whose first row is its header; raises BadInput, with `wanted`, for any other file."""
    lines = array("q")
    try:
        with file.open(newline="", encoding="utf-8-sig") as text:
            reader = csv.reader(text, strict=True)
            header = next(filter(None, reader), [])
            if len(header) > _MOST_COLUMNS:
                raise BadInput(f"{file} has {len(header)} columns, more than {_MOST_COLUMNS}: wanted are {wanted}")
            columns: list[list[str]] = [[] for _ in header]
            for row in filter(None, reader):
                if len(row) != len(header):
                    few = "fewer" if len(row) < len(header) else "more"
                    raise BadInput(
                        f"line {reader.line_num} of {file} has {few} cells than its header: give it one for every "
                        "column, and put text that holds a comma in quotes"
                    )
                for column, cell in zip(columns, row, strict=True):
                    column.append(cell)
                lines.append(reader.line_num)
    except (UnicodeDecodeError, csv.Error) as error:
        raise BadInput(f"{file} cannot be read as a CSV ({error}): wanted are the columns {wanted}") from error
    except OSError as error:
        raise BadInput(f"{file} cannot be read ({error.strerror}): wanted is a CSV with {wanted}") from error
    return CsvTable(header, columns, lines)
