"""Checks that look at lists alone: the order of names, the ground truth, and where drives begin."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from vprbench.api.dataset import Dataset, has_ground_truth
from vprbench.api.decimal_names import find_decimals
from vprbench.storage.paths import natural_keys
from vprbench.text import format_count, join_names, pick_verb

from .finding import Finding
from .traverse import Traverse, split_traverses

_HALF = 0.5
_MOST = 0.5  # mean share of the places that is right for a query
_AT_ONCE = 10_000  # names whose order is looked at
_ANY_DIGIT = str.maketrans("123456789", "0" * 9)


def check_lists(dataset: Dataset, sequences: bool = False) -> Iterator[Finding]:
    """Check names and ground truth; `sequences` says whether answers of neighbouring queries are put together."""
    references, queries = split_traverses(dataset)
    yield from _check_order(dataset, [*references, queries], dataset.by_order or sequences)
    if (np.diff(queries.places) == 1).all() and (queries.places >= 0).all():  # elsewhere equal names mean nothing
        yield from _check_pairs(queries, references[0])
        for other in references[1:]:
            yield from _check_pairs(other, references[0])
    yield from _check_ground_truth(dataset)
    yield from _name_drives(dataset)


def _check_order(dataset: Dataset, traverses: Sequence[Traverse], matters: bool) -> Iterator[Finding]:
    """Find traverses in dictionary order (1, 10, 2), where neighbours in the list are no neighbours on the road.

    `matters` says whether any answer or number rests on the order; else it is but noted.
    """
    numbers = dataset.protocol.get("numbers")
    steps = {traverse.name: step_in_dictionary_order(traverse.images.names, numbers) for traverse in traverses}
    if wrong := [name for name, step in steps.items() if step]:
        every = len(wrong) == len(traverses)
        yield Finding(
            ("warning" if every else "error") if matters else "note",
            "order",
            f"{' and '.join(wrong)} {pick_verb(wrong)} in dictionary order, not in the order of the numbers: "
            f"... {steps[wrong[0]]} ..." + ("" if every else "; the other traverses are in the order of the numbers"),
            "list the files in natural order (2 before 10), or give the numbers leading zeros"
            + ("" if matters else ", if you ask for sequences; all else is the same in any order"),
        )


def _check_pairs(traverse: Traverse, shown: Traverse) -> Iterator[Finding]:
    """Find images that stand for the place of an image of another name, though that traverse holds their own name."""
    known = set(shown.images.names)
    pairs = [
        (name, shown.images.names[place])
        for name, place in zip(traverse.images.names, traverse.places.tolist(), strict=True)
        if place < len(shown.images) and name in known
    ]
    differing = [(name, other) for name, other in pairs if name != other]
    if not differing or len(pairs) < _HALF * len(traverse.images) or len(shown.images) != len(known):
        return
    name, other = differing[0]
    yield Finding(
        "warning",
        "names",
        f"{len(differing):,} of {format_count(len(traverse.images), 'image')} of {traverse.name} are matched with one "
        f"of another name in {shown.name}, though {shown.name} holds one of the same name; the first is {name}, "
        f"matched with {other}",
        "where equal names mean equal places, a file is missing or too many before that one: compare both folders",
    )


def _check_ground_truth(dataset: Dataset) -> Iterator[Finding]:
    """Find queries without a right place, and a ground truth that is right nearly everywhere."""
    if not has_ground_truth(dataset.protocol):
        yield Finding("note", "ground truth", "there is none (ground_truth=none): no answer is judged")
        return
    counts = np.array([len(right) for right in dataset.positives])
    if names := [dataset.queries.names[query] for query in np.flatnonzero(counts == 0)]:
        wanted = dataset.protocol.get("unmatched") == "keep"
        yield Finding(
            "error" if len(names) == len(counts) else "note" if wanted else "warning",
            "ground truth",
            f"{len(names):,} of {format_count(len(counts), 'query')} have no right place and count as misses, so that "
            f"R@1 is at most {1 - len(names) / len(counts):.1%}: {join_names(names)}",
            "" if wanted else "check that both traverses show the same places, and the tolerance or radius",
        )
    guess = float(counts.mean() / dataset.n_places)
    if guess > _MOST:
        text = f"a guess is right for {guess:.1%} of all queries: so many of the {dataset.n_places:,} places are right"
        yield Finding("warning", "ground truth", text, "check the tolerance or radius")


def _name_drives(dataset: Dataset) -> Iterator[Finding]:
    """Tell how many drives queries and places consist of, where the dataset was seen to break off."""
    if "breaks" not in dataset.protocol:
        return
    for parts, breaks, names in (
        ("queries", dataset.query_breaks, dataset.queries.names),
        ("places", dataset.place_breaks, ()),
    ):
        if breaks is not None and len(breaks):
            shown = f"; all but the first begin at {join_names(names[query] for query in breaks)}" if names else ""
            yield Finding(
                "note",
                "drives",
                f"the {parts} are {format_count(len(breaks) + 1, 'drive')}, by {dataset.protocol['breaks']}{shown}",
                "no sequence reaches from one drive into the next; dataset.breaks=none takes all as one drive",
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
