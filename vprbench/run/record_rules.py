"""What the parts of a stored run or failure have to be: kinds, shapes and bounds, checked against one another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from vprbench.run.note import NoteKind

MOST_PLACES = 100_000_000  # of a map; one number of each fills 0.8 GB
_SHOWN = 60  # characters of a value in a message

_Name = Annotated[str, Field(pattern=r"^[^./\\\x00-\x1f][^/\\\x00-\x1f]*$")]  # of a file too
_Count = Annotated[int, Field(ge=0, le=1 << 53)]
_Places = Annotated[int, Field(ge=1, le=MOST_PLACES)]
_Number = Annotated[float, Field(allow_inf_nan=False)]
_Amount = Annotated[float, Field(ge=0, allow_inf_nan=False)]
_Seconds = Annotated[float, Field(ge=0, le=1e9, allow_inf_nan=False)]
_Share = Annotated[float, Field(ge=0, le=1)]


class _Part(BaseModel):
    """Values of a record as JSON gives them, none converted; those that are not named are free."""

    model_config = ConfigDict(strict=True)


class _Timed(_Part):
    """The timing protocol that was asked for."""

    model_config = ConfigDict(extra="forbid")

    minimum_seconds: _Seconds
    minimum_queries: _Count
    minimum_passes: _Count
    maximum_seconds: _Seconds
    sample: _Count
    warmup_queries: _Count
    batch_sizes: Annotated[list[Annotated[int, Field(ge=1, le=1 << 53)]], Field(min_length=1)]
    total_seconds: _Seconds | None
    rates: bool


class _Asked(_Part):
    method: dict[str, Any] = {}
    dataset: dict[str, Any] = {}
    seed: int
    device: str = "cpu"
    overrides: list[str] = []
    changed: dict[str, Any] = {}


class _AskedOfRun(_Asked):
    method: dict[str, Any]
    dataset: dict[str, Any]
    timing: _Timed | None = None


class _Protocol(_Part):
    tolerance_places: _Count = 0
    tolerance_frames: _Count = 0
    also_tolerance_places: list[_Count] = []
    tolerance_metres: _Number = 0.0
    radius_metres: _Number = 0.0


class _Commit(_Part):
    commit: str | None = None


class _Machine(_Part):
    processor: str | None = None
    time_utc: str | None = None
    cores: _Count | None = None
    threads: _Count | None = None
    memory_bytes: _Count | None = None
    platform: str | None = None
    accelerator: str | None = None
    accelerator_memory_bytes: _Count | None = None
    driver: str | None = None
    cuda: str | None = None
    governor: str | None = None
    python: str | None = None
    libraries: dict[str, str | None] = {}
    git: _Commit | None = None
    load_average: list[_Number] | None = None
    cpu_pressure_avg10: _Number | None = None


class _MachineOfRun(_Machine):
    processor: str
    time_utc: Annotated[str, Field(pattern=r"^\d{4}-\d\d-\d\d")]


class _Search(_Part):
    index: str
    bytes_per_place: _Number
    recall_at_1: _Share | None = None
    recall_at_10: _Share | None = None
    rerank: _Count = 0
    build_seconds: _Amount | None = None


class _Layer(_Part):
    name: str
    neurons: _Count
    spikes_per_query: Annotated[list[_Amount], Field(min_length=1)]
    active_share: _Share
    amplitude_mean: _Number | None
    times: list[_Count] | None = None


class _Spikes(_Part):
    queries: _Count
    layers: Annotated[list[_Layer], Field(min_length=1)]


class _Readout(_Part):
    name: str
    neurons: _Count
    hits: Annotated[list[_Share], Field(min_length=1)]
    steps: list[_Count] | None = None


class _Energy(_Part):
    values: dict[str, _Amount | None]
    how: dict[str, str]


class _Frames(_Part):
    names_sha256: str
    content_sha256: str | None
    images: _Count
    bytes: _Count | None


class _Tuned(_Part):
    dataset: str
    places: str
    also_in: dict[str, str] | list[str] = {}  # a list of names: of an earlier version


class _Note(_Part):
    model_config = ConfigDict(extra="forbid")

    kind: NoteKind
    text: str


class _Batch(_Part):
    images_per_call: Annotated[int, Field(ge=1, le=1 << 53)]
    valid: bool


class _Timing(_Part):
    first_query_seconds: float  # NaN if no query warmed up
    warmup_queries: _Count
    repeated_seconds: _Seconds
    unseen_seconds: _Seconds
    streaming_valid: bool
    offline: Annotated[list[_Batch], Field(min_length=1)]


class _Digests(_Part):
    model_config = ConfigDict(extra="forbid")  # no other file is opened

    arrays: Annotated[str, Field(alias="arrays.npz")]
    scores: Annotated[str, Field(alias="scores.npy")] = ""


class _Summary(_Part):
    method: _Name
    dataset: _Name
    key: _Name
    config: _AskedOfRun
    protocol: _Protocol
    fingerprint: str
    environment: _MachineOfRun
    notes: list[_Note]
    n_references: _Places
    n_places: _Places
    fit_seconds: _Seconds | None
    fit_compute_seconds: _Number | None
    load_seconds: _Seconds | None
    network: str | None
    search: _Search | None
    peak_memory_bytes: _Count
    harness_seconds: _Number
    method_seconds: _Number
    spikes: _Spikes | None
    readouts: list[_Readout] | None = None
    stream: list[dict[Literal["places", "hits", "seconds"], _Places | list[_Seconds]]] | None = None
    energy: _Energy | None = None
    data: _Frames | Annotated[dict[str, Any], Field(max_length=0)]
    tuned_on: _Tuned | Annotated[dict[str, Any], Field(max_length=0)]
    timing: _Timing | None
    sha256: _Digests


class _Failure(_Part):
    method: _Name
    dataset: _Name
    config: _Asked
    error: str
    environment: _Machine = _Machine()
    missing: bool = False


_INTEGERS, _NUMBERS = ("int32", "int64"), ("float32", "float64")
_HIGHEST_SCORE = float(np.finfo(np.float32).max)
_PER_QUERY = (_INTEGERS, ("queries",), 0, "places")
_LAP = (_NUMBERS, 0, 1e9)

#: The types of each array, the names of its axes, and its lowest and highest value, a name standing for a length.
_ARRAYS: Mapping[str, tuple[Sequence[str], tuple[str, ...], float, str | float]] = {
    "best_score": (_NUMBERS, ("queries",), -np.inf, _HIGHEST_SCORE),
    "top_tied": _PER_QUERY,
    "top_tied_correct": _PER_QUERY,
    "above": _PER_QUERY,
    "tied": _PER_QUERY,
    "tied_correct": _PER_QUERY,
    "n_positives": _PER_QUERY,
    "positives": (_INTEGERS, ("right places",), 0, "last place"),
    "positives_per_query": (_INTEGERS, ("queries",), 0, "right places"),
    "top_places": (_INTEGERS, ("queries", "depth"), 0, "last place"),
    "top_scores": (_NUMBERS, ("queries", "depth"), -np.inf, _HIGHEST_SCORE),
    "scores": (_NUMBERS, ("queries", "places"), -np.inf, _HIGHEST_SCORE),
    "sample": (_INTEGERS, ("sample",), 0, "last query"),
    "answers": (_INTEGERS, ("sample",), -1, "last place"),
    "place_numbers": (_INTEGERS, ("places",), -(1 << 53), 1 << 53),
    "query_breaks": (_INTEGERS, ("query breaks",), 1, "last query"),
    "place_breaks": (_INTEGERS, ("place breaks",), 1, "last place"),
}
_OPTIONAL = ("scores", "place_numbers", "query_breaks", "place_breaks")
_TIMED = ("sample", "answers")
_NEVER_MORE = (("top_tied_correct", "top_tied"), ("tied_correct", "tied"))  # the first than the second


def check_summary(summary: Mapping[str, Any]) -> None:
    """Check what is no array in a run; raises ValueError that names the first value that cannot be."""
    _check(_Summary, summary)
    if summary["n_places"] > summary["n_references"]:
        raise ValueError(f"n_places is {summary['n_places']}, of {summary['n_references']} references")


def check_failure(content: Mapping[str, Any]) -> None:
    """Check a failure; raises ValueError that names the first value that cannot be."""
    _check(_Failure, content)


def check_arrays(summary: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]]) -> None:
    """Check the arrays of a run whose summary is right; raises ValueError that names the first that cannot be."""
    lengths: dict[str, float] = {"places": summary["n_places"], "last place": summary["n_places"] - 1}
    timing = summary["timing"]
    optional = (*_OPTIONAL, *(_TIMED if timing is None else ()))
    for name, (kinds, axes, lowest, highest) in _ARRAYS.items():
        if name in arrays or name not in optional:
            _check_shape(name, arrays[name], axes, lengths)
            lengths["last query"] = lengths["queries"] - 1
            bound = lengths[highest] if isinstance(highest, str) else highest
            _check_values(name, arrays[name], kinds, lowest, bound)
    laps = [] if timing is None else ["streaming", *(f"offline_{number}" for number in range(len(timing["offline"])))]
    for lap in laps:
        for part in (f"{lap}_encode_seconds", f"{lap}_match_seconds"):
            _check_shape(part, arrays[part], (f"calls of {lap}",), lengths)
            _check_values(part, arrays[part], *_LAP)
            if not np.median(arrays[part]) > 0:
                raise ValueError(f"{part} has no median above 0")
    for fewer, more in _NEVER_MORE:
        if (arrays[fewer] > arrays[more]).any():
            raise ValueError(f"{fewer} is more than {more} somewhere")
    for readout in summary.get("readouts") or ():
        if len(readout["hits"]) != lengths["queries"]:
            raise ValueError(f"readout {readout['name']} has {len(readout['hits'])} hits, not one a query")
    if arrays["positives_per_query"].sum() != len(arrays["positives"]):
        raise ValueError("positives_per_query does not add up to the positives")


def _check(model: type[BaseModel], content: Mapping[str, Any]) -> None:
    try:
        model.model_validate(content)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
        where = ".".join(map(str, first["loc"]))
        raise ValueError(f"{where} is {_short(first['input'])}: {first['msg']}") from None


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


def _check_shape(name: str, array: npt.NDArray[Any], axes: tuple[str, ...], lengths: dict[str, float]) -> None:
    """Compare an array's shape with the lengths that are known, and note those that it is the first to tell."""
    known = array.ndim == len(axes) and [
        lengths.setdefault(axis, length) for axis, length in zip(axes, array.shape, strict=True)
    ]
    if known != list(array.shape):
        raise ValueError(f"{name} is of shape {array.shape}, which does not fit the rest")


def _check_values(name: str, array: npt.NDArray[Any], kinds: Sequence[str], lowest: float, highest: float) -> None:
    if array.dtype.name not in kinds:
        raise ValueError(f"{name} is of {array.dtype}; wanted {' or '.join(kinds)}")
    if array.size and not (array.min() >= lowest and array.max() <= highest):  # NaN is neither
        raise ValueError(f"{name} runs from {array.min()} to {array.max()}; wanted {lowest} to {highest}")
