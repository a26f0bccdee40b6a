"""Which numbers the names of frames hold: decimal (0.25 before 0.5) or whole ones (0.5 before 0.25)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from vprbench.api import BadInput, Paths, find_decimals

Numbers = Literal["auto", "decimal", "whole"]


def by_numbers(
    traverses: Sequence[Paths], numbers: Numbers, option: str = "dataset.numbers"
) -> tuple[list[Paths], dict[str, Any], list[str]]:
    """Return traverses, which come in natural order, in the order of their numbers; and what protocol and notes say.

    Under `auto` the numbers are decimal where all names of a traverse have one pattern and no fraction is a counter.
    Nothing is said where both readings give one order. Raises BadInput, which names the `option`, if `auto` would read
    some traverses in one way and some in the other.
    """
    found = [find_decimals(files.names, files.numbers.tolist()) for files in traverses]
    by_reading = {each.reading: each for each in found if each is not None}
    if numbers == "auto" and len(by_reading) == 2:
        both = [" before ".join(by_reading[way].first[:: 1 if way == "decimal" else -1]) for way in sorted(by_reading)]
        raise BadInput(
            f"{option}=auto: the names of some traverses hold decimal numbers ({both[0]}), those of others whole ones "
            f"({both[1]}): pass {option}=decimal or {option}=whole, for all of them"
        )
    taken = numbers if numbers != "auto" else next(iter(by_reading), "whole")
    first = next((each.first for each in found if each is not None), None)
    if first is None:
        return [*traverses], {}, []
    if taken == "whole":
        note = (
            f"numbers in names are read as whole ones, {first[1]} before {first[0]}; {option}=decimal: {first[0]} first"
        )
        return [*traverses], {}, [note]
    ordered = [
        files if each is None else files[np.array(each.order)] for files, each in zip(traverses, found, strict=True)
    ]
    note = f"numbers in names are read as decimals, {first[0]} before {first[1]}; {option}=whole: {first[1]} first"
    return ordered, {"numbers": "decimal"}, [note]
