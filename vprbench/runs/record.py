"""One finished run, or its failure: what each field may hold stands at the field."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, PlainValidator, ValidationInfo, with_config

from vprbench.api.dataset import has_ground_truth
from vprbench.metrics.ranking import Outcome
from vprbench.runs.notes import Note
from vprbench.runs.stopwatch import Timing
from vprbench.runs.timing_protocol import Protocol
from vprbench.runs.views import View
from vprbench.storage.bounds import (
    HIGHEST_SCORE,
    INTEGERS,
    NUMBERS,
    Amount,
    Array,
    Count,
    Fits,
    Flag,
    Name,
    Number,
    Places,
    Seconds,
    Share,
    Text,
)


class _Part(BaseModel):
    """Values as JSON gives them, none converted; values that are not named are free."""

    model_config = ConfigDict(strict=True)


class FailureConfig(_Part):
    """What was asked of a run that failed."""

    method: dict[str, Any] = {}
    dataset: dict[str, Any] = {}
    seed: int
    device: str = "cpu"
    overrides: list[str] = []
    changed: dict[str, Any] = {}


class RunConfig(FailureConfig):
    """What was asked of a run."""

    method: dict[str, Any]
    dataset: dict[str, Any]
    timing: Protocol | None = None  # of a run that was timed


class DatasetProtocol(_Part):
    """What a dataset selected, and which places it takes as right."""

    tolerance_places: Count = 0
    tolerance_frames: Count = 0
    also_tolerance_places: list[Count] = []
    tolerance_metres: Number = 0.0
    radius_metres: Number = 0.0


class _Commit(_Part):
    commit: str | None = None


class FailureMachine(_Part):
    """The machine, as far as a failed run knows it."""

    processor: str | None = None
    time_utc: str | None = None
    cores: Count | None = None
    threads: Count | None = None
    memory_bytes: Count | None = None
    platform: str | None = None
    accelerator: str | None = None
    accelerator_memory_bytes: Count | None = None
    driver: str | None = None
    cuda: str | None = None
    governor: str | None = None
    python: str | None = None
    libraries: dict[str, str | None] = {}
    git: _Commit | None = None
    load_average: list[Number] | None = None
    cpu_pressure_avg10: Number | None = None


class Machine(FailureMachine):
    """The machine of a run, and when it ran."""

    processor: str
    time_utc: Annotated[str, Field(pattern=r"^\d{4}-\d\d-\d\d")]


class Search(_Part):
    """The index of descriptors, and how often it finds what an exact search finds."""

    index: str
    bytes_per_place: Number
    recall_at_1: Share | None = None
    recall_at_10: Share | None = None
    rerank: Count = 0
    build_seconds: Amount | None = None


class _Layer(_Part):
    name: str
    neurons: Count
    spikes_per_query: Annotated[list[Amount], Field(min_length=1)]
    active_share: Share
    amplitude_mean: Number | None
    times: list[Count] | None = None


class Spikes(_Part):
    """What the layers of a spiking network fire, over a sample of the queries."""

    queries: Count
    layers: Annotated[list[_Layer], Field(min_length=1)]


#: A stop of a growing map.
Stop = dict[Literal["places", "hits", "seconds"], Places | list[Seconds]]


class Energy(_Part):
    """What a query costs, and how each figure was found."""

    values: dict[str, Amount | None]
    how: dict[str, str]


class Frames(_Part):
    """The frames of a dataset, as `identity.DataRecord` has them."""

    names_sha256: str
    content_sha256: str | None
    images: Count
    bytes: Count | None


class TunedOn(_Part):
    """The places on which the method's settings were chosen."""

    dataset: str
    places: str
    also_in: dict[str, str] = {}


Nothing = Annotated[dict[str, Any], Field(max_length=0)]


_Breaks = npt.NDArray[np.int64] | None


def _no_view(view: Any) -> None:
    if view is not None:
        raise ValueError("a view of a run is never stored")


def _right_places(positives: Any, info: ValidationInfo) -> tuple[npt.NDArray[np.int64], ...]:
    """Return the right places of each query, of which each has to be a place."""
    lengths: dict[str, int] = info.context or {}
    if len(positives) != lengths["queries"]:
        raise ValueError(f"has {len(positives)} rows; wanted {lengths['queries']}, one for each query")
    places = np.concatenate([np.empty(0, np.int64), *positives])
    if places.dtype.name not in INTEGERS or not (places >= 0).all() or not (places < lengths["places"]).all():
        raise ValueError(f"are {places.dtype} among which are no places; wanted 0 to {lengths['last place']}")
    return tuple(positives)


@with_config(ConfigDict(extra="forbid"))
@dataclass(frozen=True)
class Run:
    """What one method did on one dataset: raw answers and raw times, nothing judged."""

    method: Name
    dataset: Name
    key: Name
    config: Annotated[Mapping[str, Any], Fits(RunConfig)]  # everything that was asked for, resolved
    protocol: Annotated[Mapping[str, Any], Fits(DatasetProtocol)]  # what the dataset selected and how
    fingerprint: Text  # of the dataset's images
    environment: Annotated[Mapping[str, Any], Fits(Machine)]
    notes: tuple[Note, ...]  # what a reader of the numbers has to know
    n_references: Places
    fit_seconds: Seconds | None  # wall time, reading the images included; None: a network or descriptors were loaded
    fit_compute_seconds: Number | None  # without the time that the method waited for images
    load_seconds: Seconds | None  # wall time of reading, checking and restoring a network or descriptors
    network: Text | None  # SHA-256 of the file that was loaded
    search: Annotated[Mapping[str, Any] | None, Fits(Search | None)]  # of descriptors; None: no descriptors
    peak_memory_bytes: Count
    harness_seconds: Number  # spent neither in the method nor in reading images
    method_seconds: Number  # spent in the method
    timing: Timing | None  # None: it was not timed
    outcome: Outcome
    positives: Annotated[tuple[npt.NDArray[np.int64], ...], PlainValidator(_right_places)]  # per query
    top_places: Annotated[npt.NDArray[np.int32], Array(INTEGERS, ("queries", "depth"), 0, "last place")]  # best first
    top_scores: Annotated[  # -inf: no candidate
        npt.NDArray[np.float32], Array(NUMBERS, ("queries", "depth"), -np.inf, HIGHEST_SCORE)
    ]
    scores: (  # None: too many to keep
        Annotated[npt.NDArray[np.float32], Array(NUMBERS, ("queries", "places"), -np.inf, HIGHEST_SCORE)] | None
    )
    spikes: Annotated[Mapping[str, Any] | None, Fits(Spikes | None)] = None
    place_numbers: (  # along the journey; None: 0, 1, 2 ...
        Annotated[npt.NDArray[np.int64], Array(INTEGERS, ("places",), -(1 << 53), 1 << 53)] | None
    ) = None
    data: Annotated[Mapping[str, Any], Fits(Frames | Nothing)] = field(default_factory=dict)
    tuned_on: Annotated[Mapping[str, Any], Fits(TunedOn | Nothing)] = field(default_factory=dict)
    tuned_queries: Sequence[Count] | None = None  # which show frames of these places; None: not looked for yet
    query_breaks: Annotated[_Breaks, Array(INTEGERS, ("query breaks",), 1, "last query")] | None = None  # Dataset's
    place_breaks: Annotated[_Breaks, Array(INTEGERS, ("place breaks",), 1, "last place")] | None = None
    stream: Annotated[Sequence[Mapping[str, Any]] | None, Fits(list[Stop] | None)] = None  # of a growing map
    energy: Annotated[Mapping[str, Any] | None, Fits(Energy | None)] = None  # None: not asked for
    view: Annotated[View | None, PlainValidator(_no_view)] = None  # None: the run as it is stored

    @property
    def is_judged(self) -> bool:
        """Whether its dataset knows right places; without them no accuracy is defined."""
        return has_ground_truth(self.protocol)

    @property
    def timed_by(self) -> Protocol:
        """The protocol that it was timed by; one without rates if it was not timed."""
        asked = self.config.get("timing")
        return Protocol(rates=False) if self.timing is None or asked is None else Protocol(**asked)

    def required_timing(self) -> Timing:
        """Return what was timed; raises ValueError if nothing was, which `timing` tells beforehand."""
        if self.timing is None:
            raise ValueError(f"the run of {self.method} on {self.dataset} was not timed")
        return self.timing


@dataclass(frozen=True)
class Failure:
    """A run that ended without a result."""

    method: Name
    dataset: Name
    config: Annotated[Mapping[str, Any], Fits(FailureConfig)]
    error: Text
    environment: Annotated[Mapping[str, Any], Fits(FailureMachine)] = field(default_factory=dict)
    missing: Flag = False  # weights, frames or the method itself are not there: nothing was tried
