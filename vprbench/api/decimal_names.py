"""Numbers in file names that are no counters: with a fraction, a sign or an exponent, as 0.25, -3 and 1e-05."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import PurePath
from typing import Any, Literal

import numpy as np
from natsort import natsort_keygen, ns

from vprbench.errors import BadInput
from vprbench.storage.paths import Paths, natural_keys

NumberReading = Literal["auto", "decimal", "whole"]

_NUMBER = re.compile(r"[0-9]+(?:\.[0-9]+)?(?:[eE][-+][0-9]{2,3}(?![0-9]))?")
_DECIMAL = re.compile(r"[0-9]\.[0-9]|[0-9][eE][-+][0-9]{2}")
_VERSION = re.compile(r"[0-9]\.[0-9]+\.[0-9]")  # or a date, as 2014.12.09
_SIGN = re.compile(r"(?<![0-9])(?<![0-9][eE])-(?=[0-9])")


@dataclass(frozen=True)
class Decimals:
    """The order of names by their decimal numbers, where whole numbers give another order."""

    order: list[int]  # the numbers of the names, sorted by folders and decimal numbers
    reading: str  # decimal if all names have one pattern, and no fraction is that of a counter (1.9, 1.10), else whole
    first: tuple[str, str]  # the first two names, in the order of decimals, which whole numbers put the other way


def find_decimals(names: Sequence[str], folders: Sequence[int] | None = None) -> Decimals | None:
    """Return how file names order by decimal numbers; None if that is the order of whole numbers too.

    `folders` number the folder of each name, which comes first in the order; without them all lie in one.
    A fraction that ends in 0 beside fractions of other lengths is a counter: programs print 0.1, and not 0.10. A
    minus is a sign where some names have it and others do not. 2014.12.09 is a date, and holds no fraction.
    """
    stems = [PurePath(name).stem for name in names]
    is_signed = len({len(_SIGN.findall(stem)) for stem in stems}) > 1
    if any(map(_VERSION.search, stems)) or not (is_signed or any(map(_DECIMAL.search, stems))):
        return None
    find_key = natsort_keygen(alg=ns.REAL if is_signed else ns.FLOAT)
    of_each = [0] * len(names) if folders is None else folders
    whole = list(zip(of_each, natural_keys(names), strict=True))
    decimal = list(zip(of_each, map(find_key, stems), whole, strict=True))
    order = sorted(range(len(names)), key=decimal.__getitem__)
    differing = next(((one, two) for one, two in pairwise(order) if whole[one] > whole[two]), None)
    if differing is None:
        return None
    patterns = {_NUMBER.sub("0", _SIGN.sub("", stem) if is_signed else stem) for stem in stems}
    fractions = {found for stem in stems for found in re.findall(r"[0-9]\.([0-9]+)", stem)}
    is_counter = len({*map(len, fractions)}) > 1 and any(len(one) > 1 and one.endswith("0") for one in fractions)
    reading = "decimal" if len(patterns) == 1 and not is_counter else "whole"
    return Decimals(order, reading, (names[differing[0]], names[differing[1]]))


def order_by_numbers(
    traverses: Sequence[Paths], numbers: NumberReading, option: str = "dataset.numbers"
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
