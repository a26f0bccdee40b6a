"""One finished run, or its failure: each field with its valid values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, InstanceOf, PlainSerializer, PlainValidator, with_config

from vprbench.api.dataset import has_ground_truth
from vprbench.metrics.bounds import Count, Name, Number, Seconds, Text
from vprbench.metrics.ranking import Outcome
from vprbench.runs.notes import Note
from vprbench.runs.stopwatch import Timing
from vprbench.runs.timing_protocol import Protocol
from vprbench.runs.views import View


class _NamedPart(BaseModel):
    """Values as JSON gives them, none converted; values that are not named are free."""

    model_config = ConfigDict(strict=True)


class RunConfig(_NamedPart):
    """The options of a run."""

    method: dict[str, Any]
    dataset: dict[str, Any]
    seed: int
    device: str = "cpu"
    overrides: list[str] = []
    changed: dict[str, Any] = {}
    timing: Protocol | None = None  # of a run that was timed


class DatasetProtocol(_NamedPart):
    """Which places of a dataset count as right, among all that it selected."""

    tolerance_places: Count = 0
    tolerance_frames: Count = 0
    also_tolerance_places: list[Count] = []
    tolerance_metres: Number = 0.0
    radius_metres: Number = 0.0


class Environment(_NamedPart):
    """The machine of a run, and when it ran; `machine.describe_machine` names all parts."""

    processor: str | None = None
    time_utc: str | None = None
    cores: Count | None = None
    threads: Count | None = None
    accelerator: str | None = None
    libraries: dict[str, str | None] = {}


class Mappings(BaseModel):
    """The mappings of a run or a failure: their named parts are checked, and all stays as it is."""

    config: RunConfig
    protocol: DatasetProtocol = DatasetProtocol()
    environment: Environment = Environment()


Positives = tuple[npt.NDArray[np.int64], ...]  # the right places of each query


def _join_positives(positives: Positives) -> dict[str, npt.NDArray[np.int64]]:
    """Return the right places of all queries in one array, and how many there are of each."""
    counts = np.array([len(right) for right in positives], np.int64)
    return {"places": np.concatenate([np.empty(0, np.int64), *positives]), "counts": counts}


def _split_positives(joined: Any) -> Positives:
    """Return the right places of each query, which `_join_positives` joined."""
    ends = np.cumsum(joined["counts"])
    return tuple(np.split(joined["places"], ends[:-1])) if len(ends) else ()


@with_config(ConfigDict(extra="forbid", arbitrary_types_allowed=True))  # arrays, which are stored under their hash
@dataclass(frozen=True)
class Run:
    """One method on one dataset: raw answers and raw times, nothing judged."""

    method: Name
    dataset: Name
    key: Name
    config: Mapping[str, Any]  # all options, resolved: `RunConfig` names some
    protocol: Mapping[str, Any]  # which places the dataset selected: `DatasetProtocol` names some parts
    fingerprint: Text  # of the dataset's images
    environment: Mapping[str, Any]  # `Environment` names some parts
    notes: tuple[Note, ...]  # that a reader of the numbers needs
    n_references: Count
    fit_seconds: Seconds | None  # wall time, reading the images included; None: a network or descriptors were loaded
    fit_compute_seconds: Number | None  # without the time that the method waited for images
    load_seconds: Seconds | None  # wall time of reading, checking and restoring a network or descriptors
    network: Text | None  # SHA-256 of the file that was loaded
    search: dict[str, Any] | None  # index of descriptors; None: no descriptors
    peak_memory_bytes: Count
    harness_seconds: Number  # spent neither in the method nor in reading images
    method_seconds: Number  # spent in the method
    timing: Timing | None  # None: it was not timed
    outcome: Outcome
    positives: Annotated[Positives, PlainValidator(_split_positives), PlainSerializer(_join_positives, return_type=Any)]
    top_places: npt.NDArray[np.int32]  # (n_queries, depth), best first
    top_scores: npt.NDArray[np.float32]  # (n_queries, depth); -inf: no candidate
    scores: npt.NDArray[np.float32] | None  # (n_queries, n_places); None: too many to keep
    spikes: dict[str, Any] | None = None  # `spikes.summarise_spikes` names the parts
    place_numbers: npt.NDArray[np.int64] | None = None  # (n_places,), along the journey; None: 0, 1, 2 ...
    data: Mapping[str, Any] = field(default_factory=dict)  # as `identity.DataRecord` has it
    tuned_on: Mapping[str, Any] = field(default_factory=dict)
    tuned_queries: list[Count] = field(default_factory=list)  # that show frames of these places
    query_breaks: npt.NDArray[np.int64] | None = None  # Dataset's
    place_breaks: npt.NDArray[np.int64] | None = None
    stream: list[dict[str, Any]] | None = None  # of a growing map
    energy: dict[str, Any] | None = None  # None: not requested
    view: InstanceOf[View] | None = None  # None: the run as it is stored; a view never is

    @property
    def is_judged(self) -> bool:
        """Whether its dataset knows right places; without them no accuracy is defined."""
        return has_ground_truth(self.protocol)

    @property
    def timed_by(self) -> Protocol:
        """The protocol that it was timed by; one without rates if it was not timed."""
        options = self.config.get("timing")
        return Protocol(rates=False) if self.timing is None or options is None else Protocol(**options)

    def required_timing(self) -> Timing:
        """Return the timing; raises ValueError for a run without one."""
        if self.timing is None:
            raise ValueError(f"the run of {self.method} on {self.dataset} was not timed")
        return self.timing


@dataclass(frozen=True)
class Failure:
    """A run that ended without a result."""

    method: Name
    dataset: Name
    config: Mapping[str, Any]
    error: Text
    environment: Mapping[str, Any] = field(default_factory=dict)
    missing: bool = False  # weights, frames or the method itself are not there: nothing was tried
    traceback: Text = ""  # of an error that the method or the dataset raised
