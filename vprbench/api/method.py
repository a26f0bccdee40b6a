"""What a method has to be: it learns a map, describes images, and scores places."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self, final

import numpy as np
import numpy.typing as npt

from vprbench.api.adaptation import adapt_traverse
from vprbench.api.arrays import Places, Scores
from vprbench.api.dataset import Dataset, HeldOut
from vprbench.errors import BadInput
from vprbench.text import format_count

if TYPE_CHECKING:
    from vprbench.api.images import Images

_CODES_BYTES = 1 << 30  # of large codes held together


@dataclass(frozen=True)
class LayerSpikes:
    """What the neurons of one layer did for some queries.

    `values` (n_queries, n_neurons), 0 or more, 0 for a silent neuron: how often it spiked, or the amplitude of its one
    spike if `kind` is "amplitude". `fan_out` (n_neurons,) counts the synapses that exist from each neuron to the next
    layer; None: it leads nowhere. `times`, shaped as values, are the steps of single spikes, from 1; 0: silent.
    """

    name: str  # input, feature, output, ...
    values: npt.NDArray[Any]
    kind: Literal["count", "amplitude"] = "count"
    fan_out: npt.NDArray[Any] | None = None
    times: npt.NDArray[Any] | None = None


class Method(ABC):
    """A place recognition method: learns a map from reference images, then scores each place for a query.

    A subclass writes `fit`, `encode` and `match`, and overrides of the rest whatever its line names; the hooks stand in
    the order in which an author needs them. It is best a dataclass: its constructor only stores its arguments, and
    their type hints are what the command line checks. `references` and `images` are `Images`; codes are arrays whose
    first axis is the image. Scores are finite float32, higher means more alike; -inf marks a place that is no
    candidate. No later call changes an array that was returned.
    """

    @abstractmethod
    def fit(self, references: Images, places: Places) -> Self:
        """Learn the map and forget any earlier one.

        `places` (n_references,) holds for each reference image its place, 0 to n_places - 1, each at least once.
        """

    @abstractmethod
    def encode(self, images: Images) -> npt.NDArray[Any]:
        """Turn images into codes, (n_images, ...); whatever needs the map is left to `match`."""

    @abstractmethod
    def match(self, codes: npt.NDArray[Any]) -> Scores:
        """Score every place for every code, (n_queries, n_places); raises NotFittedError before `fit`."""

    @final
    def query(self, images: Images) -> Scores:
        """Score every place for every image, (n_images, n_places); `adapt` takes the images as one traverse."""
        codes = require_codes(self.encode(images), len(images))
        return self.match(codes if self.adapt == "none" else adapt_traverse(self, codes))

    def files(self) -> Sequence[Path]:
        """Return the files, beside the images, that its answers come from; their content is part of a run's key.

        Override it for published weights, vocabularies and lists. Raises BadInput if one is missing.
        """
        return ()

    def notes(self) -> Sequence[str]:
        """Return facts that a reader of the results has to know, a line each.

        Override it where a training or a loaded file has such facts.
        """
        return ()

    def state(self) -> Mapping[str, npt.NDArray[Any]]:
        """Return what `fit` has learnt, as named arrays of numbers; raises NotFittedError before `fit`.

        Override it, and `restore` with it, where a training takes long: `save=` and `load=` keep the network then.
        Without them both raise BadInput.
        """
        raise BadInput(f"{type(self).__name__} keeps no network that could be stored: leave save= and load= out")

    def restore(self, state: Mapping[str, npt.NDArray[Any]]) -> Self:
        """Take what `state` of the same arguments gave, and forget any earlier fit.

        Raises BadInput for arrays that are not this method's; a published file may hold any.
        """
        raise BadInput(f"{type(self).__name__} keeps no network that could be stored: leave save= and load= out")

    #: The kind of network that `state` gives, for classes that share a kind; empty: the name of the class.
    stored_as: ClassVar[str] = ""
    #: Arguments that `fit` does not depend on: a stored network fits any value of these arguments.
    query_arguments: ClassVar[frozenset[str]] = frozenset()

    def calibrate(self, held_out: HeldOut) -> Self:
        """Choose settings by held-out places; called after `fit` if the dataset has any, and timed with it.

        Override it where settings, as a threshold, need places that are no queries. The map stays the one that `fit`
        learnt.
        """
        return self

    @property
    def calibrates(self) -> bool:
        """Whether `calibrate` chooses anything under the arguments that were given; else it is not called."""
        return type(self).calibrate is not Method.calibrate

    def extend(self, references: Images, places: Places) -> Self:
        """Learn places that follow those of the map, after `fit`; the scores of known places stay what they are.

        Override it where a map can grow place by place (`stream=`). `places` (n_references,) are the numbers after the
        last known one, each at least once. Raises NotFittedError before `fit`, BadInput for other numbers and where
        places can only be learnt together.
        """
        raise BadInput(f"{type(self).__name__} learns its places together: call fit with the references of all places")

    @property
    def extends(self) -> bool:
        """Whether `extend` learns new places under the arguments that were given."""
        return type(self).extend is not Method.extend

    def centre(self, codes: npt.NDArray[np.float32], mean: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Return codes (..., n_dimensions) without a mean that fits their shape, in the form that `match` takes.

        Override it beside an argument `adapt` where codes are vectors whose mean says something of their condition.
        """
        raise BadInput(f"{type(self).__name__} has no codes that a mean can be taken off: leave method.adapt out")

    #: Whether `centre` is written, and `fit` learns `reference_mean`, so that `adapt` may be other than none.
    adapts: ClassVar[bool] = False
    #: Which mean is taken off codes between `encode` and `match`, an `Adapt`; an argument of methods with `centre`.
    adapt: Any = "none"
    #: The mean code of the references, (n_dimensions,), under any other `adapt` than none; None before `fit`.
    reference_mean: npt.NDArray[np.float32] | None = None

    def spikes(self, codes: npt.NDArray[Any]) -> Sequence[LayerSpikes]:
        """Return the spikes of each layer for these codes, first layer first; empty without spikes.

        Override it for spiking networks. Raises NotFittedError before `fit`.
        """
        return ()

    def map_bytes(self) -> int | None:
        """Return the bytes of the map that answers need; None: those of `state`, or of the index that is searched.

        Override it where the map is neither.
        """
        return None

    @property
    def code_bytes(self) -> int:
        """Bytes of one image's code; bounds how many codes are held together; 0 bounds nothing.

        Override it where a code is large, as that of local features.
        """
        return 0

    #: Rules of the conformance suite that a method cannot meet, each with the reason.
    conformance_exceptions: ClassVar[Mapping[str, str]] = {}
    #: Arguments under which the conformance suite builds the method, if its defaults do not fit 20 places.
    conformance_arguments: ClassVar[Mapping[str, Any]] = {}

    def __init_subclass__(cls, **arguments: Any) -> None:
        """Raise TypeError for a subclass that replaces `query`, which is encode and match."""
        super().__init_subclass__(**arguments)
        if "query" in cls.__dict__:
            raise TypeError(f"{cls.__name__} replaces query: write encode and match, which are timed apart")


def require_codes(codes: npt.NDArray[Any], n_images: int) -> npt.NDArray[Any]:
    """Return what `encode` gave of images; raises BadInput unless that is an array (n_images, ...)."""
    shape = getattr(codes, "shape", None)
    if shape is None or tuple(shape[:1]) != (n_images,):
        came = f"a {type(codes).__name__}" if shape is None else f"an array of shape {tuple(shape)}"
        came = "nothing" if shape is None and codes is None else came
        raise BadInput(
            f"encode returned {came} for {format_count(n_images, 'image')}: return one array whose first axis is "
            "the image, as np.stack makes of a list of vectors"
        )
    return codes


def limit_batch_size(wanted: int, code_bytes: int) -> int:
    """Return how many codes are held together: `wanted`, fewer if they would fill more than 1 GiB."""
    return min(wanted, max(1, _CODES_BYTES // code_bytes)) if code_bytes else wanted


def calibration(method: Method, dataset: Dataset) -> HeldOut | None:
    """Return the places that a method chooses its settings by; None if it chooses none or the dataset has none."""
    return dataset.held_out if method.calibrates else None


@dataclass(frozen=True)
class Circuit:
    """Fully connected layers, the first of which reads a code; the last answers with the score of every place.

    The neurons of every layer hold `weights @ x + bias`, from 0 to `clip`; unlimited on both sides if it is None.
    """

    layers: tuple[tuple[npt.NDArray[Any], npt.NDArray[Any]], ...]  # float32 weights (n_out, n_in), bias (n_out,)
    clip: float | None = None


class HasCircuit(ABC):
    """A method whose trained network is a `Circuit`."""

    @abstractmethod
    def check_circuit(self) -> None:
        """Raise BadInput, before any training, if a network of these arguments is no circuit."""

    @abstractmethod
    def circuit(self) -> Circuit:
        """Return the trained network; raises NotFittedError before `fit`."""
