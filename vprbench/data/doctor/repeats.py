"""Checks of frames that are the same, pixel by pixel: within a traverse, and between traverses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from vprbench.text import be, plural, some

from .finding import Finding
from .pictures import Seen

_WRONG_FOLDER = 0.5  # share of frames that are those of another traverse


def repeated_within(seen: Seen) -> Iterator[Finding]:
    """Find frames that are the same under different names; black and uniform ones do not count."""
    names_of: dict[bytes, dict[str, None]] = {}
    for number in _telling(seen):
        names_of.setdefault(seen.looks.contents[number], {})[seen.looks.names[number]] = None
    groups = [[*names] for names in names_of.values() if len(names) > 1]
    if not groups:
        return
    extra = sum(len(group) - 1 for group in groups)
    yield Finding(
        "warning",
        "repeated frames",
        f"{plural(extra, 'frame')} of {seen.name} {'is a copy' if extra == 1 else 'are copies'} of another frame "
        f"of {seen.name}, pixel by pixel: {some([' = '.join(group[:3]) for group in groups])}",
        "copy the right frames there; where the camera stood still, leave the repeats out of the list",
    )


def shared_between(references: Sequence[Seen], query: Seen) -> Iterator[Finding]:
    """Find traverses that hold the same frames, as where a folder was named twice."""
    traverses = [query, *references]
    for number, one in enumerate(traverses):
        for other in traverses[number + 1 :]:
            yield from _shared(one, other)


def _shared(one: Seen, other: Seen) -> Iterator[Finding]:
    known = {other.looks.contents[number]: other.looks.names[number] for number in _telling(other)}
    asked = _telling(one)
    shared = [number for number in asked if one.looks.contents[number] in known]
    if not shared:
        return
    most = len(shared) > _WRONG_FOLDER * len(asked)
    pairs = [f"{one.looks.names[number]} = {known[one.looks.contents[number]]}" for number in shared]
    yield Finding(
        "error" if most else "warning",
        "shared frames",
        f"{len(shared):,} of {plural(len(one.looks.names), 'frame')} of {one.name} {be(pairs)} also in "
        f"{other.name}, pixel by pixel: {some(pairs)}",
        "one of the two folders holds the wrong traverse: compare a frame of each by eye"
        if most
        else "copy the right frames there: a query that is also a reference is no test",
    )


def _telling(seen: Seen) -> list[int]:
    """Return the numbers of the frames that can be told from others."""
    looks = seen.looks
    return [int(number) for number in np.flatnonzero(looks.readable & ~looks.black & ~looks.uniform)]
