"""All checks of a dataset in turn: the cheap ones before every run, the others when somebody asks."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict
from typing import Literal

import numpy as np

from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.errors import BadInput

from . import files, ground_truth, names, pictures
from .alignment import alignment
from .files import Contents
from .finding import LEVELS, Finding, as_text, is_wrong
from .looking import Looks, look_at
from .recordings import of_recordings
from .shared_frames import allowed, shared_frames
from .traverse import traverses_of

_UNUSED_LOOKED_AT = 1000  # images of a folder
_SOME_LOOKED_AT = 200  # frames of a traverse, before a comparison


def quick(dataset: Dataset, sequences: bool = False) -> tuple[Finding, ...]:
    """Run the checks of names, files and ground truth; the worst findings come first.

    They decode nothing but queries that are among the references. `sequences` tells whether answers of neighbouring
    queries are put together, for which their order matters.
    """
    unused: list[Finding] = []

    def one_by_one() -> Iterator[Contents | None]:  # all together they would be larger than the dataset
        for folder in dataset.folders:
            found = files.contents(folder, len(dataset.folders))
            unused.extend(files.unused_images(found) if found else ())
            yield found

    found = [*_cheap(dataset, one_by_one(), sequences), *unused]
    shared = () if any(finding.level == "error" for finding in found) else shared_frames(dataset)
    return _sorted([*found, *shared])


def examine(dataset: Dataset) -> tuple[Finding, ...]:
    """Run all checks; every frame is decoded once, and only small pictures of them are kept.

    Reports its progress. The worst findings come first.
    """
    known = [files.contents(folder, len(dataset.folders)) for folder in dataset.folders]
    references, query = traverses_of(dataset)
    looks = [look_at(traverse.images, traverse.name) for traverse in (*references, query)]
    broken = {path for found in known if found for path in found.broken}
    return _sorted([
        *_cheap(dataset, known),
        *(finding for found in known if found for finding in _unused(found)),
        *(finding for seen in looks for finding in pictures.unreadable(seen, broken)),
        *(finding for seen in looks for finding in _of_traverse(dataset, seen)),
        *pictures.between(looks),
        *pictures.find_shared_frames(looks, allowed(dataset)),
        *alignment(dataset, looks[:-1], looks[-1]),
        *of_recordings(dataset),
    ])  # fmt: skip


def check_dataset(dataset: Dataset, sequences: bool = False) -> tuple[str, ...]:
    """Return the warnings of the checks that `quick` runs, as lines; raises BadInput for their first error."""
    found = quick(dataset, sequences)
    errors = [finding for finding in found if finding.level == "error"]
    if errors:
        more = f" ({len(errors) - 1} more, which the doctor names)" if len(errors) > 1 else ""
        raise BadInput(f"dataset {dataset.name}: {errors[0].text}: {errors[0].advice}{more}")
    return tuple(finding.text for finding in found if finding.level == "warning")


def look_at_some(dataset: Dataset) -> tuple[str, ...]:
    """Decode some frames of each traverse and return what they lack, a line each; none if frames are no files.

    Event recordings are not looked at: most pixels of their frames count none.
    """
    if not dataset.folders or dataset.recordings:
        return ()
    references, query = traverses_of(dataset)
    lines = []
    for traverse in (*references, query):
        n = len(traverse.images)
        chosen = np.linspace(0, n - 1, min(n, _SOME_LOOKED_AT)).astype(np.int64)
        seen = look_at(traverse.images[chosen], traverse.name)
        of = f"of {len(chosen):,} frames of {traverse.name}" + " that were looked at" * (len(chosen) < n)
        faults = {
            "cannot be read": ~seen.readable,
            "show nothing (black, or one grey value)": seen.black | seen.uniform,
        }
        lines += [f"{which.sum():,} {of} {fault}" for fault, which in faults.items() if which.any()]
    return tuple(lines)


def command(
    name: str,
    build: Callable[[], Dataset],
    write: Callable[[str], None],
    output: Literal["text", "json"] = "text",
) -> int:
    """Examine the dataset that `build` makes and write what was found; returns 1 for errors or warnings, 0 for none.

    A dataset that cannot be built is a finding too.
    """
    title = name
    try:
        dataset = build()
        folders = ", ".join(dict.fromkeys(str(folder.path) for folder in dataset.folders))
        title = f"{name}: {folders}" if folders else name
        found = examine(dataset)
    except BadInput as error:
        found = (Finding("error", "dataset", str(error)),)
    write(json.dumps([asdict(finding) for finding in found]) if output == "json" else as_text(title, found))
    return int(is_wrong(found))


def _cheap(dataset: Dataset, known: Iterable[Contents | None], sequences: bool = False) -> Iterator[Finding]:
    """Check the lists of the dataset, and its folders by the names and sizes of their files."""
    references, query = traverses_of(dataset)
    yield from (Finding("note", "dataset", note) for note in dataset.notes)
    yield from names.repeated_names([*references, query])
    yield from names.order([*references, query], dataset.by_order or sequences, dataset.protocol.get("numbers"))
    yield from names.names_of_places(references, query)
    yield from ground_truth.right_places(dataset)
    yield from ground_truth.course(dataset)
    yield from ground_truth.drives(dataset)
    for folder, found in zip(dataset.folders, known, strict=True):
        yield from files.of_folder(folder, found)


def _of_traverse(dataset: Dataset, seen: Looks) -> Iterator[Finding]:
    """Check the frames of a traverse, but not whether those that count events are dark or have few levels."""
    yield from pictures.turned(seen, dataset.protocol.get("exif", "obey"))
    for finding in pictures.of_traverse(seen, "levels" in dataset.protocol):
        if not dataset.recordings or finding.check not in ("black frames", "levels"):
            yield finding


def _unused(found: Contents) -> Iterator[Finding]:
    """Look at images that are not used, as far as they are not too many."""
    unused = found.unused
    if not unused:
        return
    chosen = np.linspace(0, len(unused) - 1, min(len(unused), _UNUSED_LOOKED_AT)).astype(int)
    images = Images.from_files([found.folder.path / unused[number] for number in chosen])
    looks = look_at(images, f"what {found.folder.path.name} holds beside")
    yield from files.unused_images(found, len(images), int(looks.black.sum()))


def _sorted(found: Iterable[Finding]) -> tuple[Finding, ...]:
    return tuple(sorted(found, key=lambda finding: LEVELS.index(finding.level)))
