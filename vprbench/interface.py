"""The contract between the harness and its plug-ins: what a method and a dataset have to be."""

from __future__ import annotations

import hashlib
import re
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self, final

import numpy as np
import numpy.typing as npt

from vprbench.search import Audit, Kind, Search, agreement, check_index

if TYPE_CHECKING:
    from vprbench.images import Images

Image = npt.NDArray[np.uint8]  # (height, width, 3), RGB
Places = npt.NDArray[np.int64]  # (n_references,), the place that each reference image shows
Scores = npt.NDArray[np.float32]  # (n_queries, n_places), higher means more alike; -inf: no candidate

_BLOCK = 64  # references encoded together
_BLOCK_BYTES = 1 << 26  # of decoded images in such a block
_CODES_BYTES = 1 << 30  # of large codes held together


class BadInput(ValueError):
    """What a user can mend; the message is one line that names the culprit, what came and what to do."""


class NotThere(BadInput):
    """Weights or frames that a run needs are missing; it can run once somebody has fetched them or put them there."""


class NotFittedError(RuntimeError):
    """A method was asked to match before it had learnt a map."""


class TrainingDivergedError(RuntimeError):
    """A training ended in a network that cannot be trusted; the message says how that was seen."""


@dataclass(frozen=True)
class LayerSpikes:
    """What the neurons of one layer did for some queries.

    `values` (n_queries, n_neurons), 0 or more, 0 for a silent neuron: how often it spiked, or the amplitude of its one
    spike where `kind` is "amplitude".
    """

    name: str  # input, feature, output, ...
    values: npt.NDArray[Any]
    kind: Literal["count", "amplitude"] = "count"


class Method(ABC):
    """A place recognition method: learns a map from reference images, then scores each place for a query.

    A subclass is best a dataclass: its constructor only stores its arguments, and their type hints are what
    the command line checks. `references` and `images` are `Images`; codes are arrays whose first axis is the
    image. Scores are finite float32, higher means more alike; -inf marks a place that is no candidate. No later call
    changes an array that was returned.
    """

    #: Rules of the conformance suite that a method cannot meet, each with the reason.
    conformance_exceptions: ClassVar[Mapping[str, str]] = {}
    #: Arguments under which the conformance suite builds the method, where its defaults do not fit 20 places.
    conformance_arguments: ClassVar[Mapping[str, Any]] = {}
    #: The kind of network that `state` gives, named where classes share it; empty: the class's own.
    stored_as: ClassVar[str] = ""
    #: Arguments that act at the query alone, or choose how something is computed: a network fits any value of them.
    query_arguments: ClassVar[frozenset[str]] = frozenset()

    @property
    def code_bytes(self) -> int:
        """Bytes of one image's code, where it is large: bounds how many are held together; 0 bounds nothing."""
        return 0

    @abstractmethod
    def fit(self, references: Images, places: Places) -> Self:
        """Learn the map and forget any earlier one.

        `places` (n_references,) holds for each reference image its place, 0 to n_places - 1, each at least once.
        """

    @property
    def calibrates(self) -> bool:
        """Whether `calibrate` chooses anything under the arguments that were given; else it is not called."""
        return type(self).calibrate is not Method.calibrate

    def calibrate(self, held_out: HeldOut) -> Self:
        """Choose settings by held-out places; called after `fit`, where the dataset has any, and timed as part of it.

        The map stays that of `fit`.
        """
        return self

    @abstractmethod
    def encode(self, images: Images) -> npt.NDArray[Any]:
        """Turn images into codes (n_images, ...), as far as that does not need the map."""

    @abstractmethod
    def match(self, codes: npt.NDArray[Any]) -> Scores:
        """Score every place for every code, (n_queries, n_places); raises NotFittedError before `fit`."""

    def state(self) -> Mapping[str, npt.NDArray[Any]]:
        """Return what `fit` has learnt, as named arrays of numbers; raises NotFittedError before `fit`.

        A method that can store it has `restore` as well; for the others this raises BadInput.
        """
        raise BadInput(f"{type(self).__name__} keeps no network that could be stored: leave save= and load= out")

    def restore(self, state: Mapping[str, npt.NDArray[Any]]) -> Self:
        """Take what `state` of the same arguments gave, and forget any earlier fit.

        Raises BadInput for arrays that are not this method's; a published file may hold any.
        """
        raise BadInput(f"{type(self).__name__} keeps no network that could be stored: leave save= and load= out")

    def files(self) -> Sequence[Path]:
        """Return the files, beside the images, that its answers come from; their content is part of a run's key.

        Raises BadInput where one is missing.
        """
        return ()

    def notes(self) -> Sequence[str]:
        """Return what a reader of its results has to know of what was learnt or loaded; a line each."""
        return ()

    def spikes(self, codes: npt.NDArray[Any]) -> Sequence[LayerSpikes]:
        """Return the spikes of each layer for these codes, first layer first; empty for what is no spiking network.

        Raises NotFittedError before `fit`.
        """
        return ()

    def __init_subclass__(cls, **arguments: Any) -> None:
        """Keep `query` what it is: encode and match."""
        super().__init_subclass__(**arguments)
        if "query" in cls.__dict__:
            raise TypeError(f"{cls.__name__} replaces query: write encode and match, which are timed apart")

    @final
    def query(self, images: Images) -> Scores:
        """Score every place for every image, (n_images, n_places)."""
        return self.match(self.encode(images))


@dataclass(kw_only=True, eq=False)
class DescriptorMethod(Method):
    """A method whose codes are unit vectors: only `encode` -> float32 (n_images, n_dimensions) is left to write.

    A place scores the inner product with its most similar image. `index` chooses how they are found; approximate ones
    (`hnsw`, `ivfpq`) retrieve `neighbours` images, and a place without any of these scores -inf.
    """

    query_arguments: ClassVar[frozenset[str]] = frozenset({"index", "neighbours"})
    #: Arguments that act on descriptors alone: those of a traverse are the same whatever their values.
    search_arguments: ClassVar[frozenset[str]] = frozenset({"index", "neighbours"})

    index: Kind = "exact"
    neighbours: int = 100

    #: The references, indexed; None before `fit`, and in a method that matches in a way of its own.
    searched: Search | None = field(default=None, init=False, repr=False, compare=False)

    def fit(self, references: Images, places: Places) -> Self:
        """Encode the references block by block, into one array, and learn the map from it."""
        self.searched = None
        self.insist_on_index(len(references))
        descriptors = np.empty((0, 0), np.float32)
        done = 0
        for block in encoded_blocks(references):
            codes = self.encode(block)
            if not done:
                descriptors = np.empty((len(references), codes.shape[1]), np.float32)
            descriptors[done : done + len(block)] = codes
            done += len(block)
            del block, codes  # or they would be held while the next ones are made
        return self.fit_descriptors(descriptors, places)

    def fit_descriptors(self, descriptors: npt.NDArray[np.float32], places: Places) -> Self:
        """Learn the map from what `encode` gave of the references, (n_references, n_dimensions), and forget any other.

        The array is not copied and may be memory-mapped. Raises BadInput where `index` cannot be made of it.
        """
        self.searched = None
        try:
            self.searched = Search(descriptors, places.copy(), self.index, self.neighbours)
        except ValueError as error:
            raise BadInput(f"method.index={self.index}, method.neighbours={self.neighbours}: {error}") from error
        return self

    def insist_on_index(self, n_references: int) -> None:
        """Raise BadInput where `index` cannot be made of so many references, before they are encoded."""
        if not n_references:
            raise BadInput(f"{type(self).__name__} was given no reference images: give at least one")
        try:
            check_index(self.index, self.neighbours, n_references)
        except ValueError as error:
            raise BadInput(f"method.index={self.index}, method.neighbours={self.neighbours}: {error}") from error

    def match(self, codes: npt.NDArray[np.float32]) -> Scores:
        """Return the inner product with the best reference image of each place; -inf where none was retrieved."""
        return self._indexed().scores(codes)

    def keeps_descriptors(self) -> bool:
        """Tell whether the descriptors of whole traverses are worth keeping on disk; never where a map shapes them."""
        return False

    def audit(self, codes: npt.NDArray[np.float32]) -> Audit:
        """Return how much of what exact search finds for `codes` the index finds too."""
        index = self._indexed()
        if index.kind == "exact":
            return Audit(1.0, 1.0)
        exact = index.exactly()
        blocks = [*index.blocks(codes)]
        shares = [agreement(self._matched(index, block), self._matched(exact, block)) for block in blocks]
        return Audit(*np.concatenate(shares).mean(0).tolist())

    def _matched(self, index: Search, codes: npt.NDArray[np.float32]) -> Scores:
        """Match by another index, through whatever a subclass makes of `match`."""
        kept, self.searched = self.searched, index
        try:
            return self.match(codes)
        finally:
            self.searched = kept

    def _indexed(self) -> Search:
        if self.searched is None:
            raise NotFittedError(f"{type(self).__name__} has no map yet: call fit(references, places) first")
        return self.searched


def encoded_blocks(images: Images) -> Iterator[Images]:
    """Yield consecutive images that are decoded and encoded together, fewer where they are large."""
    return images.blocks(_BLOCK, _BLOCK_BYTES)


def held_together(method: Method, wanted: int) -> int:
    """Return how many codes of a method are held together: `wanted`, fewer where they would fill more than 1 GiB."""
    code_bytes = method.code_bytes
    return min(wanted, max(1, _CODES_BYTES // code_bytes)) if code_bytes else wanted


def best_image_of_place(similarity: Scores, places: Places) -> Scores:
    """Reduce (n_queries, n_references) to (n_queries, n_places): a place is worth its most similar image."""
    if np.array_equal(places, np.arange(len(places))):
        return similarity
    order = np.argsort(places, kind="stable")
    starts = np.flatnonzero(np.diff(places[order], prepend=-1))
    return np.maximum.reduceat(similarity[:, order], starts, axis=1)


@dataclass(frozen=True)
class HeldOut:
    """Places whose queries are no part of the evaluation: a method may choose its settings by them.

    Raises BadInput where the parts do not fit one another.
    """

    references: Images  # of those places alone
    places: Places  # (n_references,), numbered from 0 on their own
    queries: Images
    right: Places  # (n_queries,), the right place of each, in that numbering
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
    """A folder that a dataset takes frames from, with what is known of it beforehand."""

    path: Path
    used: tuple[str, ...]  # file names that the dataset wants of it
    counts: tuple[int, ...] = ()  # how many images a whole, right copy holds; empty: nothing is known
    wrong_counts: Mapping[int, str] = field(default_factory=dict)  # what another count is known to mean


@dataclass(frozen=True)
class Dataset:
    """Reference and query traverses with their ground truth.

    Raises BadInput where the parts do not fit one another.
    """

    name: str
    references: Images
    places: Places  # (n_references,)
    queries: Images
    positives: tuple[npt.NDArray[np.int64], ...]  # per query the right places; empty where there is none
    protocol: Mapping[str, Any]  # what was selected and how; part of every record
    n_places: int = field(init=False)
    held_out: HeldOut | None = None  # None: there are no such places
    place_numbers: Places | None = None  # (n_places,), along the whole journey, where the map lacks some of its places
    folders: tuple[FrameFolder, ...] = ()  # where the frames lie, for checks; empty where they are no files
    notes: tuple[str, ...] = ()  # what a reader of results on it has to know; a line each, kept with every run

    def __post_init__(self) -> None:
        """Check that the parts fit one another."""
        if re.fullmatch(r"\w[\w.-]*", self.name) is None:
            raise BadInput(f"dataset.name={self.name}: give letters, digits, '.', '_' and '-', for it names a folder")
        object.__setattr__(self, "n_places", _number_of_places(f"dataset {self.name}", self.references, self.places))
        if self.place_numbers is not None and len(self.place_numbers) != self.n_places:
            raise BadInput(f"dataset {self.name}: {len(self.place_numbers)} numbers for {self.n_places} places")
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


def calibration(method: Method, dataset: Dataset) -> HeldOut | None:
    """Return the places that a method chooses its settings by; None where it chooses none or the dataset has none."""
    return dataset.held_out if method.calibrates else None


def _number_of_places(whose: str, references: Images, places: Places) -> int:
    """Return the number of places; raises BadInput where the ids do not fit the images or leave one out."""
    if not len(references):
        raise BadInput(f"{whose} has no reference images")
    if len(places) != len(references):
        raise BadInput(f"{whose}: {len(references)} reference images but {len(places)} place ids")
    n_places = int(places.max()) + 1
    unseen = np.setdiff1d(np.arange(n_places), places)
    if len(unseen) or places.min() < 0:
        raise BadInput(
            f"{whose}: place ids must run from 0 to {n_places - 1} without a gap, "
            + (f"but {unseen[:3].tolist()} are missing" if len(unseen) else f"but {int(places.min())} came")
        )
    return n_places
