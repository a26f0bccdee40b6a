"""Images that a list names for several places, steps back in time, and what they leave of recall at 1."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Hashable, Iterator, Mapping, Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt

PlacesPerQuery = Sequence[npt.NDArray[np.int64]]  # per query the right places


def ceiling(references: Sequence[Hashable], queries: Sequence[Hashable], positives: PlacesPerQuery) -> float:
    """Return the highest recall at 1 that images allow: the share of queries, 0 to 1, ties counted by expectation.

    `references` (n_places,) are the images of each place, in all traverses together, `queries` (n_queries,) those of
    the queries, and `positives` the right places of each. The rule: places of the same images score the same, and
    queries of the same image get the same answer. So queries of one image name one group of places that look alike, the
    one that holds most of their right places; each counts by the share of that group that is right for it.
    """
    size = Counter(references)
    shares: dict[Hashable, Counter[Hashable]] = defaultdict(Counter)  # by image and group, summed over its queries
    for image, right in zip(queries, positives, strict=True):
        for place in right:
            shares[image][references[place]] += 1
    best = [max(right / size[group] for group, right in groups.items()) for groups in shares.values()]
    return sum(best) / len(queries)


def sharing(images: Sequence[Hashable]) -> int:
    """Return how many of the images stand at several places."""
    return sum(count for count in Counter(images).values() if count > 1)


def steps_back(stamps: Sequence[int]) -> int:
    """Return how many steps from one timestamp to the next lead back in time."""
    return sum(later < earlier for earlier, later in pairwise(stamps))


def remarks(
    references: Mapping[str, Sequence[int]], queries: Sequence[int], positives: PlacesPerQuery, tolerance: int
) -> Iterator[str]:
    """Yield what a reader of results has to know of the list.

    `references` are the timestamps of each traverse of the map, one a place.
    """
    highest = ceiling([*zip(*references.values(), strict=True)], queries, positives)
    shared = {f"{len(stamps)} places in {name}": sharing(stamps) for name, stamps in references.items()}
    shared[f"{len(queries)} queries"] = sharing(queries)
    yield (
        f"{_counted(shared)} show an image that another one shows too: R@1 at tolerance {tolerance} can reach "
        f"{100 * highest:.2f} % at most"
    )
    back = {f"{len(stamps) - 1} steps in {name}": steps_back(stamps) for name, stamps in references.items()}
    back[f"{len(queries) - 1} steps in the queries"] = steps_back(queries)
    meaning = ": neighbours in the list are not always neighbours on the road" if any(back.values()) else ""
    yield f"{_counted(back)} lead back in time{meaning}"


def _counted(shares: Mapping[str, int]) -> str:
    words = [f"{part} of {whole}" for whole, part in shares.items()]
    return " and ".join(filter(None, [", ".join(words[:-1]), words[-1]]))
