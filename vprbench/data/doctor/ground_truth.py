"""Checks of the ground truth: queries without a right place or with very many, and how it runs along the traverse."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from vprbench.api.dataset import Dataset
from vprbench.text import plural, some

from .finding import Finding
from .traverse import advances, middles_of

_MANY = 0.1  # share of the places that is right for a query
_MOST = 0.5
_JUMP = 20  # times the usual step


def unanswerable(dataset: Dataset) -> Iterator[Finding]:
    """Find queries without a right place, which every method misses."""
    names = [name for name, right in zip(dataset.queries.names, dataset.positives, strict=True) if not len(right)]
    if not names:
        return
    total = len(dataset.queries)
    wanted = dataset.protocol.get("unmatched") == "keep"
    yield Finding(
        "error" if len(names) == total else "note" if wanted else "warning",
        "ground truth",
        f"{len(names):,} of {plural(total, 'query')} have no right place and count as misses, so that R@1 is at "
        f"most {1 - len(names) / total:.1%}: {some(names)}",
        "" if wanted else "check that both traverses show the same places, and the tolerance or radius",
    )


def too_easy(dataset: Dataset) -> Iterator[Finding]:
    """Find a ground truth under which a guess is often right."""
    share = np.array([len(right) for right in dataset.positives]) / dataset.n_places
    many = [dataset.queries.names[number] for number in np.flatnonzero(share > _MANY)]
    if not many:
        return
    guess = float(share.mean())
    yield Finding(
        "warning" if guess > _MOST else "note",
        "ground truth",
        f"for {len(many):,} of {len(share):,} queries more than {_MANY:.0%} of the {dataset.n_places:,} places are "
        f"right; a guess is right for {guess:.1%} of all",
        "check the tolerance or radius; with few places, read results beside the share that a guess reaches",
    )


def never_right(dataset: Dataset) -> Iterator[Finding]:
    """Tell how many places are right for no query: they only distract."""
    right = np.unique(np.concatenate([np.empty(0, np.int64), *dataset.positives]))
    distractors = dataset.n_places - len(right)
    if not distractors:
        return
    text = (
        f"{distractors:,} of {plural(dataset.n_places, 'place')} are right for no query: they are there to be mistaken"
    )
    yield Finding("note", "ground truth", text, "")


def wider_than_told(dataset: Dataset) -> Iterator[Finding]:
    """Find queries with more right places than the tolerance of the protocol allows."""
    tolerance = dataset.protocol.get("tolerance_places")
    if not isinstance(tolerance, int):
        return
    wide = [
        name
        for name, right in zip(dataset.queries.names, dataset.positives, strict=True)
        if len(right) > 2 * tolerance + 1
    ]
    if not wide:
        return
    yield Finding(
        "warning",
        "ground truth",
        f"a tolerance of {plural(tolerance, 'place')} allows {2 * tolerance + 1} right at most, but of "
        f"{plural(len(wide), 'query')} more are right: {some(wide)}",
        "name the tolerance that the ground truth was made with",
    )


def course(dataset: Dataset) -> Iterator[Finding]:
    """Tell where the right place goes back or leaps ahead, while it goes forward else."""
    middles = middles_of(dataset)
    asked = np.flatnonzero(middles >= 0)
    if not advances(middles):
        return
    steps = np.diff(middles[asked])
    for kind, which in (("goes back", steps < 0), ("leaps ahead", steps > _JUMP * max(1.0, float(np.median(steps))))):
        if which.any():
            names = [dataset.queries.names[asked[number + 1]] for number in np.flatnonzero(which)]
            times = plural(int(which.sum()), "time")
            text = f"the right place {kind} {times} from one query to the next: at {some(names)}"
            advice = "methods that use sequences lose the trace there"
            yield Finding("note", "ground truth", text, advice)
