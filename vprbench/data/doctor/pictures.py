"""Checks of frames: unreadable, turned, of another size, in colour or grey, black, of few levels, or the same."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from itertools import combinations
from pathlib import Path

import numpy as np

from vprbench.text import be, plural, some

from .finding import Finding, Level
from .looking import BLACK_MEAN, FEW_LEVELS, UNIFORM_STD, Looks

#: What to do about queries that are among the references.
IN_MAP = (
    "give queries of another traverse, for a query that is also a reference is no test; dataset.shared_frames=allow, "
    "in Python shared_frames='allow', goes on with a note"
)
_USUAL = 0.9  # share of the frames whose size counts as that of the traverse
_WRONG_FOLDER = 0.5  # share of frames that are those of another traverse


def unreadable(seen: Looks, known: Collection[Path]) -> Iterator[Finding]:
    """Find frames that cannot be decoded, all of them and by reason, but for files `known` to be broken."""
    known_paths: dict[str, list[str]] = {}
    for path in known:
        known_paths.setdefault(path.name, []).append(str(path))
    reasons: dict[str, list[str]] = {}
    for number, complaint in seen.unreadable.items():
        name = seen.names[number]
        if not any(path in complaint for path in known_paths.get(name, ())):
            reasons.setdefault(_reason(complaint, name), []).append(name)
    for reason, names in reasons.items():
        yield Finding(
            "error",
            "decoding",
            f"{_share(names, seen)} {reason}: {some(names)}",
            "copy or download them again; none is skipped, for that would shift all that follow",
        )


def of_traverse(seen: Looks, is_deep: bool) -> Iterator[Finding]:
    """Find frames of a traverse of another size, black ones, ones of one or few grey values, and the same ones.

    If the files of the dataset are deeper than 8 bits (`is_deep`), a range too wide may be what makes a frame black.
    """
    yield from _size(seen)
    for which, what in (
        (seen.black, f"black (mean below {BLACK_MEAN:g} of 255)"),
        (seen.uniform & ~seen.black, f"of one grey value (standard deviation below {UNIFORM_STD:g} of 255)"),
    ):
        if names := seen.named(which):
            yield Finding(
                "warning",
                "black frames",
                f"{_share(names, seen)} {be(names)} {what}: {some(names)}",
                "every method guesses there, for gamma and patch normalisation are undefined: leave such places out, "
                "by dataset=image_list with CSV files (image,place) of the others",
            )
    if names := seen.named(seen.of_few_levels & (is_deep | ~(seen.black | seen.uniform))):
        yield Finding(
            "warning",
            "levels",
            f"{_share(names, seen)} {'has' if len(names) == 1 else 'have'} fewer than {FEW_LEVELS} of 256 grey levels: "
            f"{some(names)}",
            "if the files hold more than 8 bits, give dataset.levels=LOW..HIGH, the levels that matter; else save them "
            "with more",
        )
    yield from _repeated(seen)


def turned(seen: Looks, exif: str) -> Iterator[Finding]:
    """Count the frames of a traverse that have an EXIF tag that turns them; `exif` says what becomes of it."""
    names = seen.named(seen.turned)
    has = f"{_share(names, seen)} {'has' if len(names) == 1 else 'have'} an EXIF tag that turns {some(names)}"
    if names and exif == "ignore":
        advice = "look at some: if they lie on their side, give dataset.exif=obey"
        yield Finding("warning", "exif", f"{has}: it is ignored", advice)
    elif names:
        advice = "give dataset.exif=ignore for a protocol that was published without it"
        yield Finding("note", "exif", f"{has}: it is obeyed", advice)


def _size(seen: Looks) -> Iterator[Finding]:
    """Find frames of another size than most of their traverse."""
    sizes = _sizes(seen)
    if len(sizes) < 2:
        return
    usual, times = sizes.most_common(1)[0]
    if times < _USUAL * sizes.total():
        listed = [f"{_as_text(size)} ({number:,})" for size, number in sizes.most_common()]
        yield Finding("note", "size", f"frames of {seen.traverse} have {len(sizes)} sizes: {some(listed)}")
        return
    others = seen.named(seen.readable & (seen.sizes != usual).any(1))
    yield Finding(
        "warning",
        "size",
        f"{plural(len(others), 'frame')} of {seen.traverse} {be(others)} not {_as_text(usual)}, as the other "
        f"{times:,} are: {some(others)}",
        "look at them: they may be of another camera, thumbnails, or what a server sends in place of an image",
    )


def _repeated(seen: Looks) -> Iterator[Finding]:
    """Find frames that are the same under different names; black and uniform ones do not count."""
    names_of: dict[bytes, dict[str, None]] = {}
    for name, content in _telling(seen):
        names_of.setdefault(content, {})[name] = None
    groups = [[*names] for names in names_of.values() if len(names) > 1]
    if groups:
        extra = sum(len(group) - 1 for group in groups)
        yield Finding(
            "warning",
            "repeated frames",
            f"{plural(extra, 'frame')} of {seen.traverse} {'is a copy' if extra == 1 else 'are copies'} of another "
            f"frame of {seen.traverse}, pixel by pixel: {some([' = '.join(group[:3]) for group in groups])}",
            "copy the right frames there; where the camera stood still, leave the repeats out of the list",
        )


def between(looks: Sequence[Looks]) -> Iterator[Finding]:
    """Tell where traverses differ in the size of their frames, and where some frames are grey and others in colour."""
    usual = {seen.traverse: _as_text(sizes.most_common(1)[0][0]) for seen in looks if (sizes := _sizes(seen))}
    if len(set(usual.values())) > 1:
        text = f"traverses differ in the size of their frames: {_listed(usual)}"
        yield Finding("note", "size", text, "methods that resize cope")
    kinds = {}
    for seen in looks:
        grey, coloured = int((seen.grey & seen.readable).sum()), int((~seen.grey & seen.readable).sum())
        if grey + coloured:
            mixed = f"{grey:,} grey and {coloured:,} in colour"
            kinds[seen.traverse] = "grey" if not coloured else "in colour" if not grey else mixed
    if set(kinds.values()) not in ({"grey"}, {"in colour"}):
        text = f"some frames are grey, others in colour: {_listed(kinds)}"
        yield Finding("note", "colour", text, "methods that use colour suffer")


def find_shared_frames(looks: Sequence[Looks], queries_allowed: bool) -> Iterator[Finding]:
    """Find traverses that hold the same frames, as if a folder was named twice; the queries are the last.

    Queries that are among the references are an error, unless they are allowed.
    """
    for seen, other in combinations([looks[-1], *looks[:-1]], 2):
        known = {content: name for name, content in _telling(other)}
        asked = _telling(seen)
        pairs = [f"{name} = {known[content]}" for name, content in asked if content in known]
        most = len(pairs) > _WRONG_FOLDER * len(asked)
        if pairs:
            asks = seen is looks[-1]
            level: Level = "warning" if queries_allowed or not (asks or most) else "error"
            yield Finding(
                level,
                "shared frames",
                f"{_share(pairs, seen)} {be(pairs)} also in {other.traverse}, pixel by pixel: {some(pairs)}",
                "one of the two folders holds the wrong traverse: compare a frame of each by eye" if most else IN_MAP,
            )


def _share(names: Sequence[str], seen: Looks) -> str:
    return f"{len(names):,} of {plural(len(seen.names), 'frame')} of {seen.traverse}"


def _listed(values: dict[str, str]) -> str:
    return ", ".join(f"{name} {value}" for name, value in values.items())


def _reason(complaint: str, name: str) -> str:
    """Return why an image cannot be read, without its path and without numbers of bytes."""
    said = complaint.rpartition(name)[2].partition(": ")[0].strip()
    what, bracket, why = said.partition(" (")
    return f"{what} ({why.partition(' (')[0].rstrip(')')})" if bracket else said


def _sizes(seen: Looks) -> Counter[tuple[int, int]]:
    """Return how many frames have each height and width."""
    return Counter((height, width) for height, width in seen.sizes.tolist() if height)


def _as_text(size: tuple[int, int]) -> str:
    return f"{size[1]}x{size[0]}"


def _telling(seen: Looks) -> list[tuple[str, bytes]]:
    """Return name and content of the frames that can be told from others."""
    numbers = np.flatnonzero(seen.readable & ~seen.black & ~seen.uniform)
    return [(seen.names[number], seen.contents[number]) for number in numbers]
