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
    first = {each.reading: each.first for each in found if each is not None}
    if not first:
        return [*traverses], {}, []
    if numbers == "auto" and len(first) == 2:
        (one, two), (three, four) = first["decimal"], first["whole"]
        raise BadInput(
            f"{option}=auto: the names of some traverses hold decimal numbers ({one} before {two}), those of others "
            f"whole ones ({four} before {three}): pass {option}=decimal or {option}=whole, for all of them"
        )
    taken = next(iter(first)) if numbers == "auto" else numbers
    one, two = next(iter(first.values()))
    if taken == "whole":
        note = f"numbers in names are read as whole ones, {two} before {one}; {option}=decimal: {one} first"
        return [*traverses], {}, [note]
    pairs = zip(traverses, found, strict=True)
    ordered = [files if each is None else files[np.array(each.order)] for files, each in pairs]
    note = f"numbers in names are read as decimals, {one} before {two}; {option}=whole: {two} first"
    return ordered, {"numbers": "decimal"}, [note]
