"""All checks of a dataset in turn: the cheap ones before every run, the others when somebody asks."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict
from typing import Literal

import numpy as np

from vprbench.api.dataset import Dataset
from vprbench.errors import BadInput

from .alignment import check_alignment
from .files import check_folder
from .finding import LEVELS, Finding, as_text, is_wrong
from .frames import check_frames, check_shared_files, check_shared_pixels, look_at
from .lists import check_lists
from .recordings import check_recordings
from .traverse import split_traverses

_SOME_LOOKED_AT = 200  # frames of a traverse, before a comparison


def quick(dataset: Dataset, sequences: bool = False) -> tuple[Finding, ...]:
    """Run the checks of names, files and ground truth; the worst findings come first.

    They decode nothing but queries that are among the references. `sequences` tells whether answers of neighbouring
    queries are put together, for which their order matters.
    """
    found = [*_check_cheaply(dataset, sequences)]
    shared = () if any(finding.level == "error" for finding in found) else check_shared_files(dataset)
    return _sort_findings([*found, *shared])


def examine(dataset: Dataset) -> tuple[Finding, ...]:
    """Run all checks; every frame is decoded once, and only small pictures of them are kept.

    Reports its progress. The worst findings come first.
    """
    references, query = split_traverses(dataset)
    looks = [look_at(traverse.images, traverse.name) for traverse in (*references, query)]
    return _sort_findings([
        *_check_cheaply(dataset),
        *(finding for seen in looks for finding in check_frames(dataset, seen)),
        *check_shared_pixels(dataset, looks),
        *check_alignment(dataset, looks),
        *check_recordings(dataset),
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
    references, query = split_traverses(dataset)
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


def _check_cheaply(dataset: Dataset, sequences: bool = False) -> Iterator[Finding]:
    """Check the lists of the dataset, and its folders by the names and sizes of their files."""
    yield from (Finding("note", "dataset", note) for note in dataset.notes)
    yield from check_lists(dataset, sequences)
    for folder in dataset.folders:
        yield from check_folder(folder)


def _sort_findings(found: Iterable[Finding]) -> tuple[Finding, ...]:
    return tuple(sorted(found, key=lambda finding: LEVELS.index(finding.level)))
