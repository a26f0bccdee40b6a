"""The traverses of a dataset, told apart and named."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.api.arrays import Places
from vprbench.api.dataset import Dataset
from vprbench.api.images import Images

Middles = npt.NDArray[np.int64]  # (n_queries,), the middle right place of each query; -1 if there is none

_MOSTLY = 0.9  # of the steps from query to query


@dataclass(frozen=True)
class Traverse:
    """The images of one traverse."""

    name: str  # as the protocol calls it
    images: Images
    places: Places  # (n_images,), the place of each reference; of queries the middle right place, -1 for none


def split_traverses(dataset: Dataset) -> tuple[tuple[Traverse, ...], Traverse]:
    """Return the reference traverses of a dataset, and the traverse of its queries.

    References that show the places 0 to n - 1 in this order, again and again, are several traverses; all others are
    one.
    """
    count, rest = divmod(len(dataset.references), dataset.n_places)
    if rest or not np.array_equal(dataset.places, np.tile(np.arange(dataset.n_places), count)):
        count = 1
    size = len(dataset.references) // count
    names = [*_name_references(dataset.protocol, count), _name_queries(dataset.protocol)]
    if len(set(names)) < len(names):
        names = [f"{role} {name}" for role, name in zip([*["reference"] * count, "query"], names, strict=True)]
    if len(set(names)) < len(names):
        names = [f"{name} ({number})" for number, name in enumerate(names, start=1)]
    parts = [slice(number * size, (number + 1) * size) for number in range(count)]
    references = tuple(
        Traverse(name, dataset.references[part], dataset.places[part])
        for name, part in zip(names[:-1], parts, strict=True)
    )
    return references, Traverse(names[-1], dataset.queries, find_middles(dataset))


def find_middles(dataset: Dataset) -> Middles:
    """Return the middle right place of every query; -1 if there is none.

    Right places that the first or the last place cuts off are completed to the usual number.
    """
    last = dataset.n_places - 1
    positives = [np.sort(right) for right in dataset.positives]
    inside = [len(right) for right in positives if len(right) and right[0] > 0 and right[-1] < last]
    reach = int(np.median(inside)) // 2 if inside else 0

    def find_middle(right: Places) -> int:
        if len(right) and right[0] == 0 and len(right) <= 2 * reach:
            return max(0, int(right[-1]) - reach)
        return int(right[0] + min(reach, len(right) - 1) if right[-1] == last else right[len(right) // 2])

    return np.array([find_middle(right) if len(right) else -1 for right in positives], np.int64)


def advances(middles: Middles) -> bool:
    """Tell whether the right place goes forward along the queries, but for few steps."""
    steps = np.diff(middles[middles >= 0])
    return len(steps) > 0 and bool((steps > 0).mean() >= _MOSTLY)


def _name_references(protocol: Mapping[str, Any], count: int) -> list[str]:
    named = protocol.get("references", protocol.get("reference"))
    listed = [named] if isinstance(named, str) else named if isinstance(named, Sequence) else []
    if len(listed) == count:
        return [str(name) for name in listed]
    return ["references"] if count == 1 else [f"reference traverse {number}" for number in range(1, count + 1)]


def _name_queries(protocol: Mapping[str, Any]) -> str:
    named = protocol.get("query", protocol.get("queries"))
    return named if isinstance(named, str) and named else "queries"
