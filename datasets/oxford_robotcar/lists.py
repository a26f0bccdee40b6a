"""Which image shows which place: the list that VPRTempo's authors published, and VPRSNN's; how odd both are."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Hashable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path

from vprbench.api import BadInput, MissingData, Places

#: When each traverse was recorded: its name in the RobotCar dataset.
RECORDINGS = {"sun": "2015-08-12-15-04-18", "rain": "2015-10-29-12-18-17", "dusk": "2014-11-21-16-07-03"}

_ROWS, _STRIDE, _PLACES = 3876, 8, 450  # of VPRSNN's list: its rows, and the places that its authors take from it
_STAMP = re.compile(r"(?<!\d)\d{16}(?!\d)")  # microseconds
_WHENCE = "copy ORC_{Sun,Rain,Dusk}_timestamps.csv from dataset_imagenames/ of https://github.com/QVPR/VPRSNN"


def published_timestamps(traverse: str) -> list[int]:
    """Return the 3369 timestamps of a traverse in place order (QVPR/VPRTempo 64154e5), repeated where a frame is."""
    return [int(row) for row in Path(__file__).with_name(f"oxford_{traverse}.csv").read_text("ascii").split()]


def vprsnn_timestamps(folder: Path, traverse: str) -> list[int]:
    """Return the 3876 timestamps of a traverse in place order, as VPRSNN's authors list them (QVPR/VPRSNN d38f30c).

    Raises MissingData if the file is missing, BadInput for another list.
    """
    path = folder / f"ORC_{traverse.capitalize()}_timestamps.csv"
    if not path.is_file():
        raise MissingData(f"{path} does not exist: {_WHENCE} to {folder}, or set dataset.lists to their folder")
    stamps = [int(found) for found in _STAMP.findall(path.read_text(encoding="utf-8-sig", errors="replace"))]
    distinct = len(set(stamps[: _STRIDE * _PLACES : _STRIDE]))
    if (len(stamps), distinct) != (_ROWS, _PLACES):
        raise BadInput(
            f"{path} is not VPRSNN's list of {_ROWS} images: it names {len(stamps)}, and {distinct} distinct ones in "
            f"every {_STRIDE}th row, not {_PLACES}; {_WHENCE}"
        )
    return stamps


def find_ceiling(references: Sequence[Hashable], queries: Sequence[Hashable], positives: Sequence[Places]) -> float:
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


def count_steps_back(stamps: Sequence[int]) -> int:
    """Return how many steps from one timestamp to the next lead back in time."""
    return sum(later < earlier for earlier, later in pairwise(stamps))


def describe_list(
    references: Mapping[str, Sequence[int]], queries: Sequence[int], positives: Sequence[Places], tolerance: int
) -> Iterator[str]:
    """Yield the notes on a list; `references` are the timestamps of each traverse of the map, one a place."""
    highest = find_ceiling([*zip(*references.values(), strict=True)], queries, positives)
    listed = {f"places in {name}": stamps for name, stamps in references.items()} | {"queries": queries}
    shared = [
        f"{sum(count for count in Counter(stamps).values() if count > 1)} of {len(stamps)} {name}"
        for name, stamps in listed.items()
    ]
    yield (
        f"{', '.join(shared)} show an image that another one shows too: R@1 at tolerance {tolerance} can reach "
        f"{100 * highest:.2f} % at most"
    )
    back = [f"{count_steps_back(stamps)} of {len(stamps) - 1} steps in {name}" for name, stamps in listed.items()]
    yield f"{', '.join(back)} lead back in time: neighbours in the list are not always neighbours on the road"
