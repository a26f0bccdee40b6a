"""Checks of what the frames of a traverse are like: unreadable, of another size, in colour or grey, black."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from vprbench.text import be, plural, some

from .finding import Finding
from .looking import BLACK_MEAN, UNIFORM_STD, Looks

_USUAL = 0.9  # share of the frames whose size counts as that of the traverse


@dataclass(frozen=True)
class Seen:
    """A traverse by name, and what was seen of its frames."""

    name: str
    looks: Looks

    def names(self, which: npt.NDArray[np.bool_]) -> list[str]:
        """Return the names of some of the frames."""
        return [self.looks.names[number] for number in np.flatnonzero(which)]


def unreadable(seen: Seen, known: Collection[Path]) -> Iterator[Finding]:
    """Find frames that cannot be decoded, all of them and by reason, but for files `known` to be broken."""
    known_paths: dict[str, list[str]] = {}
    for path in known:
        known_paths.setdefault(path.name, []).append(str(path))
    reasons: dict[str, list[str]] = {}
    for number, complaint in seen.looks.unreadable.items():
        name = seen.looks.names[number]
        if not any(path in complaint for path in known_paths.get(name, ())):
            reasons.setdefault(_reason(complaint, name), []).append(name)
    for reason, names in reasons.items():
        yield Finding(
            "error",
            "decoding",
            f"{len(names):,} of {plural(len(seen.looks.names), 'frame')} of {seen.name} {reason}: {some(names)}",
            "copy or download them again; none is skipped, for that would shift all that follow",
        )


def size_within(seen: Seen) -> Iterator[Finding]:
    """Find frames of another size than most of their traverse."""
    sizes = _sizes(seen)
    if len(sizes) < 2:
        return
    usual, times = sizes.most_common(1)[0]
    if times < _USUAL * sizes.total():
        listed = [f"{_as_text(size)} ({number:,})" for size, number in sizes.most_common()]
        yield Finding("note", "size", f"frames of {seen.name} have {len(sizes)} sizes: {some(listed)}", "")
        return
    others = seen.names(seen.looks.readable & (seen.looks.sizes != usual).any(1))
    yield Finding(
        "warning",
        "size",
        f"{plural(len(others), 'frame')} of {seen.name} {be(others)} not {_as_text(usual)}, as the other "
        f"{times:,} are: {some(others)}",
        "look at them: they may be of another camera, thumbnails, or what a server sends in place of an image",
    )


def size_between(all_seen: Sequence[Seen]) -> Iterator[Finding]:
    """Tell where traverses differ in the size of their frames."""
    usual = {seen.name: sizes.most_common(1)[0][0] for seen in all_seen if (sizes := _sizes(seen))}
    if len(set(usual.values())) < 2:
        return
    listed = ", ".join(f"{name} {_as_text(size)}" for name, size in usual.items())
    yield Finding("note", "size", f"traverses differ in the size of their frames: {listed}", "methods that resize cope")


def colour_between(all_seen: Sequence[Seen]) -> Iterator[Finding]:
    """Tell where some frames are grey and others in colour."""
    kinds = {}
    for seen in all_seen:
        grey = int((seen.looks.grey & seen.looks.readable).sum())
        coloured = int(seen.looks.readable.sum()) - grey
        if grey + coloured:
            mixed = f"{grey:,} grey and {coloured:,} in colour"
            kinds[seen.name] = "grey" if not coloured else "in colour" if not grey else mixed
    if set(kinds.values()) in ({"grey"}, {"in colour"}):
        return
    listed = ", ".join(f"{name} {kind}" for name, kind in kinds.items())
    yield Finding(
        "note", "colour", f"some frames are grey, others in colour: {listed}", "methods that use colour suffer"
    )


def black(seen: Seen) -> Iterator[Finding]:
    """Find black frames and frames of one grey value: their gamma or patch normalisation is undefined."""
    looks = seen.looks
    for which, what in (
        (looks.black, f"black (mean below {BLACK_MEAN:g} of 255)"),
        (looks.uniform & ~looks.black, f"of one grey value (standard deviation below {UNIFORM_STD:g} of 255)"),
    ):
        if names := seen.names(which):
            frames = plural(len(looks.names), "frame")
            text = f"{len(names):,} of {frames} of {seen.name} {be(names)} {what}: {some(names)}"
            advice = (
                "leave such places out of the list: gamma and patch normalisation are undefined there, and every "
                "method guesses"
            )
            yield Finding("warning", "black frames", text, advice)


def _reason(complaint: str, name: str) -> str:
    """Return why an image cannot be read, without its path and without numbers of bytes."""
    said = complaint.rpartition(name)[2].partition(": ")[0].strip()
    what, bracket, why = said.partition(" (")
    return f"{what} ({why.partition(' (')[0].rstrip(')')})" if bracket else said


def _sizes(seen: Seen) -> Counter[tuple[int, int]]:
    """Return how many frames have each height and width."""
    return Counter((height, width) for height, width in seen.looks.sizes.tolist() if height)


def _as_text(size: tuple[int, int]) -> str:
    return f"{size[1]}x{size[0]}"
