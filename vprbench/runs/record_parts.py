"""The plain parts of a record: mappings that stay mappings, with what the harness reads in them."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from vprbench.runs.timing_protocol import Protocol
from vprbench.storage.bounds import Amount, Count, Number, Places, Seconds, Share


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


class Readout(_Part):
    """What a layer finds on its own: a hit or none for each query."""

    name: str
    neurons: Count
    hits: Annotated[list[Share], Field(min_length=1)]
    steps: list[Count] | None = None


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
