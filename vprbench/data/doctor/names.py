"""Checks of file names: repeated, in dictionary order, or not those of the place they are matched with."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise

from vprbench.api.decimal_names import find_decimals
from vprbench.storage.paths import natural_keys
from vprbench.text import be, plural, some

from .finding import Finding
from .traverse import Traverse, one_by_one

_HALF = 0.5
_AT_ONCE = 10_000  # names whose order is looked at
_ANY_DIGIT = str.maketrans("123456789", "0" * 9)


def repeated_names(traverses: Sequence[Traverse]) -> Iterator[Finding]:
    """Find names that stand in a traverse more than once."""
    for traverse in traverses:
        names = traverse.images.names
        if extra := len(names) - len(set(names)):
            repeated = [name for name, times in Counter(names).items() if times > 1]
            yield Finding(
                "note",
                "names",
                f"the list of {traverse.name} repeats {plural(len(repeated), 'name')}, {plural(extra, 'time')} in "
                f"{plural(len(names), 'image')}: {some(repeated)}",
                "where the list is yours, remove the repeats; where it is published, keep them: rows are places",
            )


def order(traverses: Sequence[Traverse], matters: bool, numbers: str | None = None) -> Iterator[Finding]:
    """Find traverses in dictionary order (1, 10, 2), where neighbours in the list are no neighbours on the road.

    `matters` says whether any answer or number rests on the order; else it is but noted. `numbers` is what the protocol
    says of numbers in names.
    """
    steps = {traverse.name: step_in_dictionary_order(traverse.images.names, numbers) for traverse in traverses}
    wrong = [name for name, step in steps.items() if step]
    if wrong:
        every = len(wrong) == len(traverses)
        yield Finding(
            ("warning" if every else "error") if matters else "note",
            "order",
            f"{' and '.join(wrong)} {be(wrong)} in dictionary order, not in the order of the numbers: "
            f"... {steps[wrong[0]]} ..." + ("" if every else "; the other traverses are in the order of the numbers"),
            "list the files in natural order (2 before 10), or give the numbers leading zeros"
            + ("" if matters else ", if you ask for sequences; all else is the same in any order"),
        )


def names_of_places(references: Sequence[Traverse], query: Traverse) -> Iterator[Finding]:
    """Find images matched with one of another name, though that traverse holds one of the same name.

    Only if every next image is said to show the next place: elsewhere equal names mean nothing.
    """
    if not one_by_one(query.places):
        return
    first = references[0]
    for other in references[1:]:
        yield from _differing(other, range(len(other.images)), first)
    yield from _differing(query, query.places.tolist(), first)


def _differing(traverse: Traverse, places: Sequence[int], shown: Traverse) -> Iterator[Finding]:
    known = set(shown.images.names)
    pairs = [
        (name, shown.images.names[place])
        for name, place in zip(traverse.images.names, places, strict=True)
        if place < len(shown.images) and name in known
    ]
    differing = [(name, other) for name, other in pairs if name != other]
    if not differing or len(pairs) < _HALF * len(places) or len(shown.images) != len(known):
        return
    name, other = differing[0]
    yield Finding(
        "warning",
        "names",
        f"{len(differing):,} of {plural(len(places), 'image')} of {traverse.name} are matched with one of another "
        f"name in {shown.name}, though {shown.name} holds one of the same name; the first is {name}, matched with "
        f"{other}",
        "where equal names mean equal places, a file is missing or too many before that one: compare both folders",
    )


def step_in_dictionary_order(names: Sequence[str], numbers: str | None = None) -> str:
    """Return where names sorted by their characters first differ from the order of their numbers; empty if nowhere.

    Names in the order of their decimal numbers (0.25, 0.5) are in order, where they hold such or `numbers` says so.
    """
    as_wide = (name.translate(_ANY_DIGIT) for name in names)  # leading zeros make both orders one
    first = next(as_wide, "")
    if all(name == first for name in as_wide) or any(one > two for one, two in pairwise(names)):
        return ""
    decimals = find_decimals(names)
    if decimals and "decimal" in (decimals.reading, numbers) and decimals.order == sorted(decimals.order):
        return ""
    for start in range(0, len(names), _AT_ONCE):
        keys = natural_keys(names[start : start + _AT_ONCE + 1])
        for number, (one, two) in enumerate(pairwise(keys), start):
            if one > two:
                return ", ".join(names[max(0, number - 1) : number + 2])
    return ""
