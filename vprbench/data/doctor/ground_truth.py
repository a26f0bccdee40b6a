"""Checks of the ground truth: queries without a right place or with very many, and how it runs along the traverse."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from vprbench.api.dataset import Dataset, has_ground_truth
from vprbench.text import plural, some

from .finding import Finding
from .traverse import advances, middles_of

_MANY = 0.1  # share of the places that is right for a query
_MOST = 0.5
_JUMP = 20  # times the usual step


def right_places(dataset: Dataset) -> Iterator[Finding]:
    """Find queries without a right place or with too many, and places that are right for no query."""
    if not has_ground_truth(dataset.protocol):
        yield Finding("note", "ground truth", "there is none (ground_truth=none): no answer is judged")
        return
    counts = np.array([len(right) for right in dataset.positives])
    total, n_places, tolerance = len(counts), dataset.n_places, dataset.protocol.get("tolerance_places")
    if names := _names(dataset, counts == 0):
        wanted = dataset.protocol.get("unmatched") == "keep"
        yield Finding(
            "error" if len(names) == total else "note" if wanted else "warning",
            "ground truth",
            f"{len(names):,} of {plural(total, 'query')} have no right place and count as misses, so that R@1 is at "
            f"most {1 - len(names) / total:.1%}: {some(names)}",
            "" if wanted else "check that both traverses show the same places, and the tolerance or radius",
        )
    share = counts / n_places
    if many := int((share > _MANY).sum()):
        guess = float(share.mean())
        yield Finding(
            "warning" if guess > _MOST else "note",
            "ground truth",
            f"for {many:,} of {total:,} queries more than {_MANY:.0%} of the {n_places:,} places are right; a guess is "
            f"right for {guess:.1%} of all",
            "check the tolerance or radius; with few places, read results beside the share that a guess reaches",
        )
    if distractors := n_places - len({place for right in dataset.positives for place in right.tolist()}):
        told = f"{distractors:,} of {plural(n_places, 'place')} are right for no query: they are there to be mistaken"
        yield Finding("note", "ground truth", told)
    if isinstance(tolerance, int) and (names := _names(dataset, counts > 2 * tolerance + 1)):
        yield Finding(
            "warning",
            "ground truth",
            f"a tolerance of {plural(tolerance, 'place')} allows {2 * tolerance + 1} right at most, but of "
            f"{plural(len(names), 'query')} more are right: {some(names)}",
            "name the tolerance that the ground truth was made with",
        )


def course(dataset: Dataset) -> Iterator[Finding]:
    """Tell where the right place goes back or leaps ahead, while it goes forward else."""
    middles = middles_of(dataset)
    if not advances(middles):
        return
    steps = np.diff(middles[middles >= 0])
    after = np.flatnonzero(middles >= 0)[1:]
    for kind, which in (("goes back", steps < 0), ("leaps ahead", steps > _JUMP * max(1.0, float(np.median(steps))))):
        if which.any():
            names = [dataset.queries.names[query] for query in after[which]]
            text = f"the right place {kind} {plural(len(names), 'time')} from one query to the next: at {some(names)}"
            yield Finding("note", "ground truth", text, "methods that use sequences lose the trace there")


def drives(dataset: Dataset) -> Iterator[Finding]:
    """Tell how many drives queries and places consist of, where the dataset was seen to break off."""
    if "breaks" not in dataset.protocol:
        return
    told = ("queries", dataset.query_breaks, dataset.queries.names), ("places", dataset.place_breaks, ())
    for what, breaks, names in told:
        if breaks is None or not len(breaks):
            continue
        shown = f"; all but the first begin at {some(names[query] for query in breaks)}" if names else ""
        yield Finding(
            "note",
            "drives",
            f"the {what} are {plural(len(breaks) + 1, 'drive')}, by {dataset.protocol['breaks']}{shown}",
            "no sequence reaches from one drive into the next; dataset.breaks=none takes all as one drive",
        )


def _names(dataset: Dataset, which: np.ndarray) -> list[str]:
    return [dataset.queries.names[query] for query in np.flatnonzero(which)]
