"""Tables in CSV files, as pandas, Excel and Windows write them."""

from __future__ import annotations

import codecs
import re
from pathlib import Path
from typing import TYPE_CHECKING

from vprbench.api import BadInput

if TYPE_CHECKING:
    import pandas as pd

_SEPARATOR_LINE = re.compile(r'"?sep=(.)"?[,;\t]*\s*', re.IGNORECASE)
_LONGEST_HEADER = 1 << 20  # characters
_DECIMAL = r"\s*[-+]?\d*(?:,\d+)?\s*"
_THOUSANDS = r"\s*[-+]?\d{1,3},\d{3}\s*"


def read_csv(file: Path, wanted: str) -> pd.DataFrame:
    """Return the cells of a CSV file as text, by the names of its first row in small letters; blank lines are none.

    Cells stand between commas. Where the header has none they stand between semicolons or tabs, and decimal commas are
    points. A line `sep=;` above the header names another sign. Cells that a row lacks are empty. Raises BadInput, with
    the columns that are `wanted`, for any other file, and for a row of more cells.
    """
    import pandas as pd

    try:
        encoding = find_encoding(file)
        with file.open(encoding=encoding) as text:
            first = text.readline(_LONGEST_HEADER)
        named = _SEPARATOR_LINE.fullmatch(first)
        separator = named[1] if named else next((sign for sign in ",;\t" if sign in first), ",")
        cells = pd.read_csv(
            file,
            sep=separator,
            encoding=encoding,
            header=None,  # pandas drops surplus cells where it knows a header
            dtype=str,
            keep_default_na=False,
            skiprows=int(bool(named)),
        )
    except (OSError, ValueError) as error:  # pandas' own errors are ValueErrors, and so is text in another encoding
        reason = " ".join(str(error).split())
        advice = f"give each row a cell for each column, write decimals with a point, save it in UTF-8: {wanted}"
        raise BadInput(f"{file} cannot be read as a CSV ({reason}): {advice}") from error
    table = cells.iloc[1:].reset_index(drop=True)
    table.columns = cells.iloc[0].str.strip().str.lower()
    return table if separator == "," else table.apply(_write_points)


def find_encoding(file: Path) -> str:
    """Return the encoding of a text: UTF-16 if its first bytes say so, as Excel and Notepad write, else UTF-8."""
    with file.open("rb") as raw:
        start = raw.read(2)
    return "utf-16" if start in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE) else "utf-8-sig"


def _write_points(cells: pd.Series[str]) -> pd.Series[str]:
    """Return numbers with decimal points for their commas, unless these may stand between thousands."""
    commas = cells[cells.str.contains(",")]
    if not cells.str.fullmatch(_DECIMAL).all() or commas.str.fullmatch(_THOUSANDS).all():
        return cells
    return cells.str.replace(",", ".")
