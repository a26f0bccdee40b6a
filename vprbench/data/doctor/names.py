"""Checks of file names: repeated, in dictionary order, or not those of the place they are matched with."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise

from natsort import natsort_keygen

from vprbench.text import plural, some

from .finding import Finding
from .traverse import Traverse, one_by_one

_HALF = 0.5
_ANY_DIGIT = str.maketrans("123456789", "0" * 9)


def repeated_names(traverse: Traverse) -> Iterator[Finding]:
    """Find names that stand in a traverse more than once."""
    names = traverse.images.names
    repeated = [name for name, times in Counter(names).items() if times > 1]
    if not repeated:
        return
    extra = len(names) - len(set(names))
    yield Finding(
        "note",
        "names",
        f"the list of {traverse.name} repeats {plural(len(repeated), 'name')}, {plural(extra, 'time')} in "
        f"{plural(len(names), 'image')}: {some(repeated)}",
        "where the list is yours, remove the repeats; where it is published, keep them: rows are places",
    )


def order(references: Sequence[Traverse], query: Traverse) -> Iterator[Finding]:
    """Find traverses in dictionary order (1, 10, 2), where neighbours in the list are no neighbours on the road."""
    traverses = [*references, query]
    wrong = [traverse for traverse in traverses if _in_dictionary_order(traverse.images.names)]
    if not wrong:
        return
    names = wrong[0].images.names
    key = natsort_keygen()
    step = next(number for number, (one, two) in enumerate(pairwise(names)) if key(one) > key(two))
    shown = ", ".join(names[max(0, step - 1) : step + 2])
    told = " and ".join(traverse.name for traverse in wrong)
    yield Finding(
        "warning" if len(wrong) == len(traverses) else "error",
        "order",
        f"{told} {'is' if len(wrong) == 1 else 'are'} in dictionary order, not in the order of the numbers: "
        f"... {shown} ..."
        + ("" if len(wrong) == len(traverses) else "; the other traverses are in the order of the numbers"),
        "list the files in natural order (2 before 10), or give the numbers leading zeros",
    )


def names_of_places(references: Sequence[Traverse], query: Traverse) -> Iterator[Finding]:
    """Find images matched with one of another name, though that traverse holds one of the same name.

    Only where every next image is said to show the next place: elsewhere equal names mean nothing.
    """
    if not one_by_one(query.places):
        return
    first = references[0]
    for other in references[1:]:
        yield from _differing(other, range(len(other.images)), first)
    yield from _differing(query, query.places.tolist(), first)


def _differing(asked: Traverse, places: Sequence[int], shown: Traverse) -> Iterator[Finding]:
    known = set(shown.images.names)
    pairs = [
        (name, shown.images.names[place])
        for name, place in zip(asked.images.names, places, strict=True)
        if place < len(shown.images) and name in known
    ]
    differing = [(name, other) for name, other in pairs if name != other]
    if not differing or len(pairs) < _HALF * len(places) or len(shown.images) != len(known):
        return
    name, other = differing[0]
    yield Finding(
        "warning",
        "names",
        f"{len(differing):,} of {plural(len(places), 'image')} of {asked.name} are matched with one of another "
        f"name in {shown.name}, though {shown.name} holds one of the same name; the first is {name}, matched with "
        f"{other}",
        "where equal names mean equal places, a file is missing or too many before that one: compare both folders",
    )


def _in_dictionary_order(names: Sequence[str]) -> bool:
    """Tell whether names are sorted by their characters, and differently from their numbers."""
    as_wide = {name.translate(_ANY_DIGIT) for name in names}  # leading zeros make both orders one
    if len(as_wide) == 1 or [*names] != sorted(names):
        return False
    key = natsort_keygen()
    return any(key(one) > key(two) for one, two in pairwise(names))
