"""One pass over the frames of a traverse, and their checks: unreadable, turned, black, of few levels, or the same."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from vprbench import progress
from vprbench.api.arrays import Image
from vprbench.api.dataset import Dataset
from vprbench.api.images import Images, hash_images_of_both
from vprbench.errors import BadInput
from vprbench.storage.cores import count_cores
from vprbench.text import format_count, join_few, join_names, pick_verb

from .files import name_impostor
from .finding import Finding, Level

Small = npt.NDArray[np.uint8]  # (n_images, 16, 32), grey
Which = npt.NDArray[np.bool_]  # (n,), of the frames

#: Mean grey value, of 255, below which a frame is black: of Nordland's tunnels, not of its winter or of a night drive.
BLACK_MEAN = 16.0
#: Standard deviation of the grey values, of 255, below which a frame shows nothing.
UNIFORM_STD = 3.0
#: Grey levels of 256 below which little of a frame is left, as of 12 bits read as 16.
FEW_LEVELS = 32

_HEIGHT, _WIDTH = 16, 32
_READERS = min(8, count_cores())
_USUAL = 0.9  # share of the frames whose size counts as that of the traverse
_WRONG_FOLDER = 0.5  # share of frames that are those of another traverse
_IN_MAP = (
    "give queries of another traverse, for a query that is also a reference is no test; dataset.shared_frames=allow, "
    "in Python shared_frames='allow', goes on with a note"
)


@dataclass(frozen=True)
class Looks:
    """The facts kept of a traverse's frames, in order; of an unreadable frame its error alone."""

    traverse: str
    names: tuple[str, ...]
    turned: Which  # whether the file has an EXIF tag that turns the frame, obeyed or not
    unreadable: Mapping[int, str]  # the reason by the number of the frame; empty: the file is missing or empty
    contents: tuple[bytes, ...]  # hash of the pixels; empty if unreadable
    sizes: npt.NDArray[np.int64]  # (n, 2), width and height; 0 if unreadable
    mean: npt.NDArray[np.float64]  # (n,), of the grey values
    std: npt.NDArray[np.float64]  # (n,)
    n_levels: npt.NDArray[np.int64]  # (n,), different grey values
    small: Small  # (n, 16, 32)

    @property
    def readable(self) -> Which:
        """Which frames were decoded, (n,)."""
        return self.sizes[:, 0] > 0

    @property
    def black(self) -> Which:
        """Which frames are black, (n,)."""
        return self.readable & (self.mean < BLACK_MEAN)

    @property
    def uniform(self) -> Which:
        """Which frames show nothing, black or not, (n,)."""
        return self.readable & (self.std < UNIFORM_STD)

    def list_names(self, which: Which) -> list[str]:
        """Return the names of some of the frames."""
        return [self.names[number] for number in np.flatnonzero(which)]

    def list_telling(self) -> list[tuple[str, bytes]]:
        """Return name and content of the frames that can be told from others."""
        numbers = np.flatnonzero(self.readable & ~self.black & ~self.uniform)
        return [(self.names[number], self.contents[number]) for number in numbers]

    def count_share(self, names: Sequence[str]) -> str:
        """Return how many of the frames have these names, in words."""
        return f"{len(names):,} of {format_count(len(self.names), 'frame')} of {self.traverse}"


def look_at(images: Images, traverse: str) -> Looks:
    """Decode every image once, in threads, and keep what the checks need; an unreadable image ends nothing."""
    unreadable: dict[int, str] = {}

    def look(number: int) -> tuple[bytes, tuple[int, int], float, float, int, Small]:
        try:
            return _measure(images[number])
        except BadInput as error:
            unreadable[number] = _name_reason(None if images.files is None else images.files[number], error)
            return b"", (0, 0), 0.0, 0.0, 0, np.zeros((_HEIGHT, _WIDTH), np.uint8)

    looks = []
    with ThreadPoolExecutor(_READERS) as readers:
        for each in readers.map(look, range(len(images))):
            looks.append(each)
            progress.report(f"looking at {traverse}", len(looks) / len(images))
    contents, *values = zip(*looks, strict=True)
    arrays = [np.array(value) for value in values]
    turned = np.isin(np.arange(len(images)), images.turned())
    return Looks(traverse, images.names, turned, dict(sorted(unreadable.items())), contents, *arrays)


def _name_reason(file: Path | None, error: BadInput) -> str:
    """Return why a frame cannot be decoded; nothing of a file that is missing or empty, for its folder is checked."""
    if file is not None and (not file.is_file() or not file.stat().st_size):
        return ""
    kind = None if file is None else name_impostor(file)
    why = str(error).partition(" (")[2].partition(" (")[0].partition(")")[0]
    return kind or why or str(error)


def _measure(image: Image) -> tuple[bytes, tuple[int, int], float, float, int, Small]:
    """Return what `Looks` keeps of a frame, in the order of its fields."""
    grey = cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY)
    mean, std = cv2.meanStdDev(grey)
    content = hashlib.sha256(repr(image.shape).encode() + image.tobytes()).digest()
    n_levels = int(np.count_nonzero(cv2.calcHist([grey], [0], None, [256], [0, 256])))
    small = cv2.resize(grey, (_WIDTH, _HEIGHT), interpolation=cv2.INTER_AREA).astype(np.uint8, copy=False)
    return content, (image.shape[1], image.shape[0]), float(mean[0, 0]), float(std[0, 0]), n_levels, small


def check_frames(dataset: Dataset, seen: Looks) -> Iterator[Finding]:
    """Check the frames of a traverse; those that count events may be dark and have few levels."""
    yield from _check_reading(seen)
    yield from _check_exif(seen, dataset.protocol.get("exif", "obey"))
    yield from _check_sizes(seen)
    if not dataset.recordings:
        yield from _check_light(seen, "levels" in dataset.protocol)
    yield from _check_repeats(seen)


def _check_reading(seen: Looks) -> Iterator[Finding]:
    reasons: dict[str, list[str]] = {}
    for number, reason in seen.unreadable.items():
        reasons.setdefault(reason, []).append(seen.names[number])
    reasons.pop("", None)
    for reason, names in reasons.items():
        yield Finding(
            "error",
            "decoding",
            f"{seen.count_share(names)} cannot be decoded ({reason}): {join_names(names)}",
            "copy or download them again; none is skipped, for that would shift all that follow",
        )


def _check_exif(seen: Looks, exif: str) -> Iterator[Finding]:
    if names := seen.list_names(seen.turned):
        has = f"{seen.count_share(names)} {'has' if len(names) == 1 else 'have'} an EXIF tag that turns "
        has += join_names(names)
        if exif == "ignore":
            advice = "look at some: if they lie on their side, give dataset.exif=obey"
            yield Finding("warning", "exif", f"{has}: it is ignored", advice)
        else:
            advice = "give dataset.exif=ignore for a protocol that was published without it"
            yield Finding("note", "exif", f"{has}: it is obeyed", advice)


def _check_sizes(seen: Looks) -> Iterator[Finding]:
    """Find frames of another size than most of their traverse."""
    sizes = Counter(map(tuple, seen.sizes[seen.readable].tolist()))
    if len(sizes) < 2:
        return
    (usual, times), *_ = sizes.most_common(1)
    others = seen.list_names(seen.readable & (seen.sizes != usual).any(1))
    yield Finding(
        "note" if times < _USUAL * sizes.total() else "warning",
        "size",
        f"{format_count(len(others), 'frame')} of {seen.traverse} {pick_verb(others)} not {usual[0]}x{usual[1]}, as "
        f"the other {times:,} are: {join_names(others)}",
        "look at them: they may be of another camera, thumbnails, or what a server sends in place of an image",
    )


def _check_light(seen: Looks, is_deep: bool) -> Iterator[Finding]:
    """Find frames that are black, of one grey value or of few; of deep files a range too wide may be the reason."""
    for which, kind in (
        (seen.black, f"black (mean below {BLACK_MEAN:g} of 255)"),
        (seen.uniform & ~seen.black, f"of one grey value (standard deviation below {UNIFORM_STD:g} of 255)"),
    ):
        if names := seen.list_names(which):
            yield Finding(
                "warning",
                "black frames",
                f"{seen.count_share(names)} {pick_verb(names)} {kind}: {join_names(names)}",
                "every method guesses there, for gamma and patch normalisation are undefined: leave such places out, "
                "by dataset=image_list with CSV files (image,place) of the others",
            )
    few = seen.readable & (seen.n_levels < FEW_LEVELS) & (is_deep | ~(seen.black | seen.uniform))
    if names := seen.list_names(few):
        yield Finding(
            "warning",
            "levels",
            f"{seen.count_share(names)} {'has' if len(names) == 1 else 'have'} fewer than {FEW_LEVELS} of 256 grey "
            f"levels: {join_names(names)}",
            "if the files hold more than 8 bits, give dataset.levels=LOW..HIGH, the levels that matter; else save them "
            "with more",
        )


def _check_repeats(seen: Looks) -> Iterator[Finding]:
    """Find frames that are the same under different names."""
    names_of: dict[bytes, dict[str, None]] = {}
    for name, content in seen.list_telling():
        names_of.setdefault(content, {})[name] = None
    if groups := [[*names] for names in names_of.values() if len(names) > 1]:
        extra = sum(len(group) - 1 for group in groups)
        yield Finding(
            "warning",
            "repeated frames",
            f"{format_count(extra, 'frame')} of {seen.traverse} {'is a copy' if extra == 1 else 'are copies'} of "
            f"another frame of {seen.traverse}, pixel by pixel: "
            f"{join_names([' = '.join(group[:3]) for group in groups])}",
            "copy the right frames there; where the camera stood still, leave the repeats out of the list",
        )


def check_shared_pixels(dataset: Dataset, looks: Sequence[Looks]) -> Iterator[Finding]:
    """Find traverses that hold the same frames, as if a folder was named twice; the queries are the last of `looks`.

    Queries that are among the references are an error, unless the dataset allows them.
    """
    for seen, other in combinations([looks[-1], *looks[:-1]], 2):
        known = {content: name for name, content in other.list_telling()}
        telling = seen.list_telling()
        pairs = [f"{name} = {known[content]}" for name, content in telling if content in known]
        most = len(pairs) > _WRONG_FOLDER * len(telling)
        if pairs:
            harmless = _allows_shared(dataset) or not (seen is looks[-1] or most)
            level: Level = "warning" if harmless else "error"
            yield Finding(
                level,
                "shared frames",
                f"{seen.count_share(pairs)} {pick_verb(pairs)} also in {other.traverse}, pixel by pixel: "
                f"{join_names(pairs)}",
                "one of the two folders holds the wrong traverse: compare a frame of each by eye" if most else _IN_MAP,
            )


def check_shared_files(dataset: Dataset) -> Iterator[Finding]:
    """Find queries that are among the references, by the content of files or the pixels of arrays, under any name.

    Black queries and those of one grey value pass, and rendered frames and windows of event recordings are not looked
    at. Raises BadInput for a file that cannot be read.
    """
    codes = hash_images_of_both(dataset.references, dataset.queries)
    if codes is None:
        return
    references, queries = codes
    first = {code: number for number, code in reversed([*enumerate(references.tolist())])}
    shared = np.flatnonzero(np.isin(queries, references))
    if not len(shared):
        return
    seen = look_at(dataset.queries[shared], "queries that are in the map")
    telling = shared[~seen.black & ~seen.uniform].tolist()
    names, known = dataset.queries.names, dataset.references.names
    pairs = [" = ".join(dict.fromkeys((names[q], known[first[int(queries[q])]]))) for q in telling]
    if pairs:
        yield Finding(
            "warning" if _allows_shared(dataset) else "error",
            "shared frames",
            f"{len(pairs):,} of {format_count(len(queries), 'query')} {pick_verb(pairs)} among the references: "
            f"{join_few(pairs)}",
            _IN_MAP,
        )


def _allows_shared(dataset: Dataset) -> bool:
    return dataset.protocol.get("shared_frames") == "allow"
