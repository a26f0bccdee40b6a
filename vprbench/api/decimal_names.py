"""Numbers in file names that are no counters: with a fraction, a sign or an exponent, as 0.25, -3 and 1e-05."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from itertools import pairwise
from pathlib import PurePath

from vprbench.storage.paths import natural_keys

_NUMBER = re.compile(r"(-?)([0-9]+(?:\.[0-9]+)*(?:[eE][-+][0-9]{2,3}(?![0-9]))?)")
_DECIMAL = re.compile(r"[0-9]\.[0-9]|[0-9][eE][-+][0-9]{2}")
_SIGNED = re.compile(r"-[0-9]")


@dataclass(frozen=True)
class Decimals:
    """The order of names by their decimal numbers, where whole numbers give another order."""

    keys: list[str]  # of each name: sorting by these puts 0.25 before 0.5, -3 before -2 and 1e-05 before 0.1
    order: list[int]  # the numbers of the names, sorted by folders and keys
    likely: bool  # whether all names have one pattern, and no fraction is that of a counter, as in 1.9, 1.10
    first: tuple[str, str]  # the first two names, in the order of decimals, which whole numbers put the other way

    @property
    def reading(self) -> str:
        """How the numbers are read by default: decimal or whole."""
        return "decimal" if self.likely else "whole"


def find_decimals(names: Sequence[str], folders: Sequence[int] | None = None) -> Decimals | None:
    """Return how file names order by decimal numbers; None if that is the order of whole numbers too.

    `folders` number the folder of each name, which comes first in the order; without them all lie in one.
    A fraction that ends in 0 beside fractions of other lengths is a counter: programs print 0.1, and not 0.10. A
    minus is a sign where some names have it and others do not. 2014.12.09 is a date, and holds no fraction.
    """
    if not _may_hold_decimals(names):
        return None
    split = [_NUMBER.split(PurePath(name).stem) for name in names]
    patterns = {tuple(parts[::3]) for parts in split}
    columns = [
        [(parts[at + 1], parts[at + 2]) for parts in split if at + 2 < len(parts)]
        for at in range(0, max(map(len, split)) - 1, 3)
    ]
    signed = [len(patterns) == 1 and len({sign for sign, _ in column}) == 2 for column in columns]
    ranks = [
        _rank_numbers([(sign if has_sign else "") + number for sign, number in column])
        for column, has_sign in zip(columns, signed, strict=True)
    ]
    keys = natural_keys([_replace_numbers(parts, signed, ranks) for parts in split])
    of_each = [0] * len(names) if folders is None else folders
    whole = list(zip(of_each, natural_keys(names), strict=True))
    order = sorted(range(len(names)), key=lambda at: (of_each[at], keys[at], whole[at]))
    differing = next(((one, two) for one, two in pairwise(order) if whole[one] > whole[two]), None)
    if differing is None:
        return None
    likely = len(patterns) == 1 and not any(_is_counter([number for _, number in column]) for column in columns)
    return Decimals(keys, order, likely, (names[differing[0]], names[differing[1]]))


def _may_hold_decimals(names: Sequence[str]) -> bool:
    return any(map(_DECIMAL.search, names)) or (
        any("-" in name for name in names) and len({len(_SIGNED.findall(name)) for name in names}) > 1
    )


def _rank_numbers(numbers: Sequence[str]) -> dict[str, int]:
    """Return where among all different numbers each stands; dates as 2014.12.09 order by their parts."""
    by_value = {text: _parse_number(text) for text in {*numbers}}
    known = {value: rank for rank, value in enumerate(sorted({*by_value.values()}))}
    return {text: known[value] for text, value in by_value.items()}


def _parse_number(text: str) -> tuple[Decimal, ...]:
    return (Decimal(text),) if text.count(".") < 2 else tuple(map(Decimal, re.findall("[0-9]+", text)))


def _replace_numbers(parts: Sequence[str], signed: Sequence[bool], ranks: Sequence[dict[str, int]]) -> str:
    """Return a name, cut into texts, signs and numbers, with the rank of each number in the place of it."""
    shown = [parts[0]]
    for column, (sign, number, text) in enumerate(zip(parts[1::3], parts[2::3], parts[3::3], strict=True)):
        shown += [] if signed[column] else [sign]
        shown += [str(ranks[column][(sign if signed[column] else "") + number]), text]
    return "".join(shown)


def _is_counter(numbers: Sequence[str]) -> bool:
    """Tell whether some fraction of different lengths ends in a 0 that no program prints behind a decimal point."""
    fractions = {found[1] for number in numbers if (found := re.fullmatch(r"[0-9]+\.([0-9]+)", number))}
    return len({len(one) for one in fractions}) > 1 and any(len(one) > 1 and one.endswith("0") for one in fractions)
