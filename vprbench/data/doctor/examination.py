"""All checks of a dataset in turn: the cheap ones before every run, the others when somebody asks."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.errors import BadInput

from . import files, ground_truth, names, pictures, repeats
from .alignment import alignment
from .files import Contents
from .finding import Finding
from .looking import look_at
from .pictures import Seen
from .traverse import traverses_of

_UNUSED_LOOKED_AT = 1000  # images of a folder
_LEVELS = ("error", "warning", "note")


def quick(dataset: Dataset) -> tuple[Finding, ...]:
    """Run the checks that decode nothing: names, files and ground truth; the worst findings come first."""
    known = [files.contents(folder) for folder in dataset.folders]
    unused = (finding for found in known if found for finding in files.unused_images(found))
    return _sorted([*_of_lists(dataset), *_of_files(dataset, known), *unused])


def examine(dataset: Dataset) -> tuple[Finding, ...]:
    """Run all checks; every frame is decoded once, and only small pictures of them are kept.

    Reports its progress. The worst findings come first.
    """
    known = [files.contents(folder) for folder in dataset.folders]
    references, query = traverses_of(dataset)
    seen = [Seen(one.name, look_at(one.images, f"looking at {one.name}")) for one in (*references, query)]
    looks = [one.looks for one in seen]
    broken = {path for one in known if one for path in one.broken}
    found = [
        *_of_lists(dataset),
        *_of_files(dataset, known),
        *(finding for one in known if one for finding in _unused(one)),
        *(finding for one in seen for finding in pictures.unreadable(one, broken)),
        *(finding for one in seen for finding in _of_traverse(one)),
        *pictures.size_between(seen),
        *pictures.colour_between(seen),
        *repeats.shared_between(seen[:-1], seen[-1]),
        *alignment(dataset, looks[:-1], looks[-1]),
    ]
    return _sorted(found)


def insist(dataset: Dataset) -> tuple[str, ...]:
    """Return the warnings of the cheap checks as lines; raises BadInput for their first error."""
    found = quick(dataset)
    errors = [finding for finding in found if finding.level == "error"]
    if errors:
        more = f" ({len(errors) - 1} more, which the doctor names)" if len(errors) > 1 else ""
        raise BadInput(f"dataset {dataset.name}: {errors[0].text}: {errors[0].advice}{more}")
    return tuple(finding.text for finding in found if finding.level == "warning")


def _of_lists(dataset: Dataset) -> Iterator[Finding]:
    """Check what needs neither files nor frames."""
    references, query = traverses_of(dataset)
    yield from (Finding("note", "dataset", note, "") for note in dataset.notes)
    for traverse in (*references, query):
        yield from names.repeated_names(traverse)
    yield from names.order(references, query)
    yield from names.names_of_places(references, query)
    for check in (
        ground_truth.unanswerable,
        ground_truth.too_easy,
        ground_truth.never_right,
        ground_truth.wider_than_told,
        ground_truth.course,
    ):
        yield from check(dataset)


def _of_files(dataset: Dataset, known: Sequence[Contents | None]) -> Iterator[Finding]:
    """Check the folders by the names and sizes of their files."""
    for folder, found in zip(dataset.folders, known, strict=True):
        if found is None:
            yield files.no_folder(folder)
            continue
        for check in (files.missing_files, files.count, files.empty_files, files.impostors, files.strangers):
            yield from check(found)


def _unused(found: Contents) -> Iterator[Finding]:
    """Look at images that are not used, as far as they are not too many."""
    unused = found.unused
    if not unused:
        return
    chosen = np.linspace(0, len(unused) - 1, min(len(unused), _UNUSED_LOOKED_AT)).astype(int)
    images = Images.from_files([found.folder.path / unused[number] for number in chosen])
    looks = look_at(images, f"looking at what {found.folder.path.name} holds beside")
    yield from files.unused_images(found, len(images), int(looks.black.sum()))


def _of_traverse(seen: Seen) -> Iterator[Finding]:
    for check in (pictures.size_within, pictures.black, repeats.repeated_within):
        yield from check(seen)


def _sorted(found: Iterable[Finding]) -> tuple[Finding, ...]:
    return tuple(sorted(found, key=lambda finding: _LEVELS.index(finding.level)))
