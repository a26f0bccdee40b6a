"""What a dataset has to be: two traverses, their places and their ground truth."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
import numpy.typing as npt

from vprbench.api.arrays import Places
from vprbench.errors import BadInput
from vprbench.text import format_count, shorten

if TYPE_CHECKING:
    from vprbench.api.events import Recording
    from vprbench.api.images import Images


SharedFrames = Literal["error", "allow"]  # what becomes of queries that are among the references


def has_ground_truth(protocol: Mapping[str, Any]) -> bool:
    """Tell whether a dataset of this protocol knows right places; under `ground_truth: none` no answer is judged."""
    return protocol.get("ground_truth") != "none"


@dataclass(frozen=True)
class HeldOut:
    """Places whose queries no result asks: a method may choose its settings by these places.

    Raises BadInput if the parts do not fit one another.
    """

    references: Images  # of the held-out places alone
    places: Places  # (n_references,), numbered from 0 on their own
    queries: Images
    right: Places  # (n_queries,), the right place of each query, numbered as `places`
    in_map: bool  # whether the references are also among those of the dataset
    n_places: int = field(init=False)

    def __post_init__(self) -> None:
        """Check that the parts fit one another."""
        object.__setattr__(self, "n_places", _number_of_places("held-out places", self.references, self.places))
        if not len(self.queries) or len(self.right) != len(self.queries):
            raise BadInput(
                f"held-out places: {len(self.queries)} queries but {len(self.right)} right places; "
                "wanted one for each of at least one query"
            )
        if not 0 <= self.right.min() <= self.right.max() < self.n_places:
            raise BadInput(
                f"held-out places: the right places run from {self.right.min()} to {self.right.max()}, "
                f"the places from 0 to {self.n_places - 1}"
            )

    def fingerprint(self) -> str:
        """Return the hash of images, order and ground truth."""
        digest = hashlib.sha256(self.references.fingerprint().encode())
        digest.update(self.places.tobytes())
        digest.update(self.queries.fingerprint().encode())
        digest.update(self.right.tobytes())
        return digest.hexdigest()


@dataclass(frozen=True)
class FrameFolder:
    """A folder that a dataset takes frames from, with the numbers of images that are known of it beforehand."""

    path: Path
    used: tuple[str, ...]  # file names that the dataset wants of it
    counts: tuple[int, ...] = ()  # how many images a whole, right copy holds; empty: nothing is known
    wrong_counts: Mapping[int, str] = field(default_factory=dict)  # what another count is known to mean


@dataclass(frozen=True, repr=False)
class Dataset:
    """Reference and query traverses with their ground truth.

    Raises BadInput if the parts do not fit one another.
    """

    name: str
    references: Images
    places: Places  # (n_references,)
    queries: Images
    positives: tuple[npt.NDArray[np.int64], ...]  # per query the right places; empty if there is none
    protocol: Mapping[str, Any]  # what was selected and how; part of every record
    n_places: int = field(init=False)
    held_out: HeldOut | None = None  # None: there are no such places
    place_numbers: Places | None = None  # (n_places,), along the whole journey, if the map lacks some of its places
    query_breaks: Places | None = None  # queries, ascending, before which frames of the journey are missing
    place_breaks: Places | None = None  # the same of the map's places
    folders: tuple[FrameFolder, ...] = ()  # where the frames lie, for checks; empty if they are no files
    recordings: tuple[Recording, ...] = ()  # of event cameras: of reference traverses, then of queries; for checks
    notes: tuple[str, ...] = ()  # what a reader of results on it has to know; a line each, kept with every run
    by_order: bool = True  # whether the order of the images says which places are right

    def __post_init__(self) -> None:
        """Check that the parts fit one another."""
        if re.fullmatch(r"\w[\w.-]*", self.name) is None:
            raise BadInput(f"dataset.name={self.name}: give letters, digits, '.', '_' and '-', for it names a folder")
        object.__setattr__(self, "n_places", _number_of_places(f"dataset {self.name}", self.references, self.places))
        if self.place_numbers is not None and len(self.place_numbers) != self.n_places:
            raise BadInput(f"dataset {self.name}: {len(self.place_numbers)} numbers for {self.n_places} places")
        for what, breaks, n in (
            ("query", self.query_breaks, len(self.queries)),
            ("place", self.place_breaks, self.n_places),
        ):
            if breaks is not None and not np.isin(breaks, np.arange(1, n)).all():
                raise BadInput(f"dataset {self.name}: {what}_breaks must lie between 1 and {n - 1}, not {list(breaks)}")
        if not len(self.queries):
            raise BadInput(f"dataset {self.name} has no query images: ask for at least one")
        if len(self.positives) != len(self.queries):
            raise BadInput(
                f"dataset {self.name}: {len(self.queries)} queries but ground truth for {len(self.positives)}"
            )
        for query, right in enumerate(self.positives):
            if len(right) and not (right.min() >= 0 and right.max() < self.n_places):
                wrong = int(right.min() if right.min() < 0 else right.max())
                raise BadInput(
                    f"dataset {self.name}: the ground truth of query {query} ({self.queries.names[query]}) names "
                    f"place {wrong}, but places run from 0 to {self.n_places - 1}"
                )

    def __repr__(self) -> str:
        """Return name and sizes in one line."""
        sizes = zip((self.n_places, len(self.references), len(self.queries)), ("place", "image", "query"), strict=True)
        return shorten(f"<dataset {self.name}: {', '.join(format_count(*size) for size in sizes)}>")

    def with_shared_frames(self, given: SharedFrames) -> Self:
        """Return a dataset whose protocol says that its queries may be among its references, if that is `allow`."""
        return self if given == "error" else replace(self, protocol={**self.protocol, "shared_frames": given})


def _number_of_places(whose: str, references: Images, places: Places) -> int:
    """Return the number of places; raises BadInput if the ids do not fit the images or leave one out."""
    if not len(references):
        raise BadInput(f"{whose} has no reference images")
    if len(places) != len(references):
        raise BadInput(f"{whose}: {len(references)} reference images but {len(places)} place ids")
    n_places = int(places.max()) + 1
    seen = np.zeros(max(0, n_places), bool)
    seen[places[places >= 0]] = True
    unseen = np.flatnonzero(~seen)
    if len(unseen) or places.min() < 0:
        raise BadInput(
            f"{whose}: place ids must run from 0 to {n_places - 1} without a gap, "
            + (f"but {unseen[:3].tolist()} are missing" if len(unseen) else f"but {int(places.min())} came")
        )
    return n_places
