"""One finished run, or its failure, and the files that hold it: checked, without pickle."""

from __future__ import annotations

import hashlib
import json
import logging
import os
import stat
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.metrics.ranking import Outcome
from vprbench.run.note import Note
from vprbench.run.record_rules import check_arrays, check_failure, check_summary
from vprbench.run.stopwatch import Laps, Timing, plain
from vprbench.run.timing_protocol import Protocol
from vprbench.run.views import View

logger = logging.getLogger(__name__)

SCHEMA = 8
SUMMARY, _ARRAYS, _SCORES, _FAILURE = "run.json", "arrays.npz", "scores.npy", "failure.json"
_LARGEST_SUMMARY = 1 << 26  # bytes


class DamagedRunError(Exception):
    """A folder of the store does not hold a whole run; the message says what is wrong with it."""


class UnreadableRunError(Exception):
    """The system refuses to read a run, which may be whole; the message says why."""


class OtherLayoutError(Exception):
    """A folder of the store holds a run of an earlier or later version of this program; the message names both."""


@dataclass(frozen=True)
class Run:
    """What one method did on one dataset: raw answers and raw times, nothing judged."""

    method: str
    dataset: str
    key: str
    config: Mapping[str, Any]  # everything that was asked for, resolved
    protocol: Mapping[str, Any]  # what the dataset selected and how
    fingerprint: str  # of the dataset's images
    environment: Mapping[str, Any]
    notes: tuple[Note, ...]  # what a reader of the numbers has to know
    n_references: int
    fit_seconds: float | None  # wall time, reading the images included; None: a network or descriptors were loaded
    fit_compute_seconds: float | None  # without the time that the method waited for images
    load_seconds: float | None  # wall time of reading, checking and restoring those
    network: str | None  # SHA-256 of the file that was loaded
    search: Mapping[str, Any] | None  # of descriptors: index, bytes_per_place, recall_at_1, ...; None: no such
    peak_memory_bytes: int
    harness_seconds: float  # spent neither in the method nor in reading images
    method_seconds: float  # spent in the method
    timing: Timing | None  # None: it was not timed
    outcome: Outcome
    positives: tuple[npt.NDArray[np.int64], ...]  # per query the right places
    top_places: npt.NDArray[np.int32]  # (n_queries, depth), best first
    top_scores: npt.NDArray[np.float32]  # (n_queries, depth); -inf: no candidate
    scores: npt.NDArray[np.float32] | None  # (n_queries, n_places) where that is small enough to keep
    spikes: Mapping[str, Any] | None = None  # of a spiking network, over a sample of the queries
    place_numbers: npt.NDArray[np.int64] | None = None  # (n_places,), along the journey; None: 0, 1, 2 ...
    data: Mapping[str, Any] = field(default_factory=dict)  # data_record(dataset)
    tuned_on: Mapping[str, Any] = field(default_factory=dict)  # TunedOn; empty: on nothing
    query_breaks: npt.NDArray[np.int64] | None = None  # Dataset's
    place_breaks: npt.NDArray[np.int64] | None = None
    readouts: Sequence[Mapping[str, Any]] | None = None  # name, neurons, hits of each query; None: not asked for
    stream: Sequence[Mapping[str, Any]] | None = None  # places, hits, seconds of each stop of a growing map
    energy: Mapping[str, Any] | None = None  # values, how each was found, meters; None: not asked for
    view: View | None = None  # None: the run as it is stored

    @property
    def training_seconds(self) -> float | None:
        """The wall time until queries take their usual time: the fit, and what the first query took beyond a usual one.

        None if nothing was fitted; the fit alone if queries were not timed.
        """
        return None if self.fit_seconds is None else self.fit_seconds + self._first_query_excess_seconds

    @property
    def training_compute_seconds(self) -> float | None:
        """The same without the time that the method waited for images."""
        computing = self.fit_compute_seconds
        return None if computing is None else computing + self._first_query_excess_seconds

    @property
    def _first_query_excess_seconds(self) -> float:
        return 0.0 if self.timing is None else self.timing.first_query_excess_seconds

    @property
    def timed_by(self) -> Protocol:
        """The protocol that it was timed by; one without rates if it was not timed."""
        asked = self.config.get("timing")
        return Protocol(rates=False) if self.timing is None or asked is None else Protocol(**asked)

    def insist_on_timing(self) -> Timing:
        """Return what was timed; raises ValueError if nothing was, which `timing` tells beforehand."""
        if self.timing is None:
            raise ValueError(f"the run of {self.method} on {self.dataset} was not timed")
        return self.timing


@dataclass(frozen=True)
class Failure:
    """A run that ended without a result."""

    method: str
    dataset: str
    config: Mapping[str, Any]
    error: str
    environment: Mapping[str, Any] = field(default_factory=dict)  # of the machine
    missing: bool = False  # weights, frames or the method itself are not there: nothing was tried


def content_key(content: Mapping[str, Any]) -> str:
    """Return the hash of plain values: of all that can change an outcome, or of a summary itself."""
    text = json.dumps({"schema": SCHEMA, **content}, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def load(folder: Path) -> Run:
    """Read a run of this layout.

    Raises DamagedRunError if a part is missing, changed or cannot be, UnreadableRunError if the system does not
    let it be read, OtherLayoutError for any other layout.
    """
    try:
        summary = _summary(_content(folder / SUMMARY, _LARGEST_SUMMARY))
        digests = summary["sha256"]
        for name, digest in digests.items():
            if _digest(_regular(folder / name)) != digest:
                raise DamagedRunError(f"{name} is not what was written")
        with np.load(folder / _ARRAYS, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        if _SCORES in digests:
            arrays["scores"] = np.load(folder / _SCORES, mmap_mode="r", allow_pickle=False)
        check_arrays(summary, arrays)
        return _from_parts(summary, arrays)
    except (DamagedRunError, OtherLayoutError):
        raise
    except (FileNotFoundError, NotADirectoryError) as error:
        raise DamagedRunError(f"{Path(error.filename).name} is missing") from error
    except (OSError, MemoryError) as error:
        raise UnreadableRunError(_reason(error)) from error
    except Exception as error:  # what is wrong inside of a file may upset its reader in any way
        raise DamagedRunError(f"{type(error).__name__}: {error}") from error


def _summary(content: bytes) -> dict[str, Any]:
    """Return what is no array of a run, checked."""
    summary: dict[str, Any] = json.loads(content)
    layout = summary["schema"]
    if type(layout) is not int or layout < 1:
        raise DamagedRunError(f"its layout is {layout!r}")
    if layout != SCHEMA:
        raise OtherLayoutError(f"its layout is version {layout}, this program reads {SCHEMA}: run it again")
    if summary.pop("content_key") != content_key(summary):
        raise DamagedRunError(f"{SUMMARY} is not what was written")
    check_summary(summary)
    return {"readouts": None, "stream": None, "energy": None, **summary}  # unknown to earlier versions


_OUTCOME = [field.name for field in fields(Outcome) if field.name != "n_places"]
_IF_KNOWN = ("place_numbers", "query_breaks", "place_breaks")
_RANKED = ("outcome", "positives", "top_places", "top_scores", "scores")
_OF_THEIR_OWN = {"notes", "timing", "view", *_RANKED, *_IF_KNOWN}
_PLAIN = [field.name for field in fields(Run) if field.name not in _OF_THEIR_OWN]


def write(run: Run, folder: Path) -> None:
    """Write a run into an empty folder, its summary last.

    Raises OSError if the disk refuses, ValueError for a run that `load` would not take, and for a view of a run.
    """
    if run.view is not None:
        raise ValueError("a view of a run is never stored")
    arrays = {name: getattr(run.outcome, name) for name in _OUTCOME}
    arrays |= {
        **({} if run.timing is None else _timed_arrays(run.timing)),
        **{name: known for name in _IF_KNOWN if (known := getattr(run, name)) is not None},
        "top_places": run.top_places,
        "top_scores": run.top_scores,
        "positives": np.concatenate([np.empty(0, np.int64), *run.positives]),
        "positives_per_query": np.array([len(right) for right in run.positives]),
    }
    np.savez_compressed(folder / _ARRAYS, allow_pickle=False, **arrays)
    if run.scores is not None:
        np.save(folder / _SCORES, run.scores, allow_pickle=False)
    summary = {name: getattr(run, name) for name in _PLAIN}
    summary |= {
        "schema": SCHEMA,
        "notes": [note._asdict() for note in run.notes],
        "n_places": run.outcome.n_places,
        "timing": None if run.timing is None else plain(run.timing),
        "sha256": {path.name: _digest(path) for path in sorted(folder.iterdir())},
    }
    check_summary(json.loads(json.dumps(summary)))
    _write_json(folder / SUMMARY, {**summary, "content_key": content_key(summary)})


def _timed_arrays(timing: Timing) -> dict[str, npt.NDArray[Any]]:
    arrays: dict[str, npt.NDArray[Any]] = {"sample": timing.sample, "answers": timing.answers}
    offline = {f"offline_{number}": laps for number, laps in enumerate(timing.offline)}
    for name, lap in {"streaming": timing.streaming, **offline}.items():
        arrays |= {f"{name}_encode_seconds": lap.encode_seconds, f"{name}_match_seconds": lap.match_seconds}
    return arrays


def _timing(plain: Mapping[str, Any] | None, arrays: Mapping[str, npt.NDArray[Any]]) -> Timing | None:
    if plain is None:
        return None

    def laps(name: str, images_per_call: int, valid: bool) -> Laps:
        return Laps(arrays[f"{name}_encode_seconds"], arrays[f"{name}_match_seconds"], images_per_call, valid)

    return Timing(
        plain["first_query_seconds"],
        plain["warmup_queries"],
        laps("streaming", 1, plain["streaming_valid"]),
        tuple(
            laps(f"offline_{number}", lap["images_per_call"], lap["valid"])
            for number, lap in enumerate(plain["offline"])
        ),
        arrays["sample"],
        arrays["answers"],
        plain["repeated_seconds"],
        plain["unseen_seconds"],
    )


def _from_parts(summary: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]]) -> Run:
    ends = np.cumsum(arrays["positives_per_query"])[:-1]
    return Run(
        **{name: summary[name] for name in _PLAIN} | {name: arrays.get(name) for name in _IF_KNOWN},
        notes=tuple(Note(**note) for note in summary["notes"]),
        timing=_timing(summary["timing"], arrays),
        outcome=Outcome(**{name: arrays[name] for name in _OUTCOME}, n_places=summary["n_places"]),
        positives=tuple(np.split(arrays["positives"], ends)),
        top_places=arrays["top_places"],
        top_scores=arrays["top_scores"],
        scores=arrays.get("scores"),
    )


def write_failure(failure: Failure, folder: Path) -> None:
    """Write a failure into an empty folder; raises OSError if the disk refuses."""
    _write_json(folder / _FAILURE, asdict(failure))


def read_failure(folder: Path) -> Failure | None:
    """Read a failure; None if there is none or, with a warning, none whole."""
    path = folder / _FAILURE
    try:
        content = json.loads(_content(path, _LARGEST_SUMMARY))
        check_failure(content)
        return Failure(**{part.name: content[part.name] for part in fields(Failure) if part.name in content})
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, MemoryError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        logger.warning("%s cannot be used (%s)", path, _reason(error))
        return None


def _write_json(path: Path, content: Mapping[str, Any]) -> None:
    with path.open("x", encoding="utf-8") as file:
        json.dump(content, file, indent=1)
        file.flush()
        os.fsync(file.fileno())


def _content(path: Path, most_bytes: int) -> bytes:
    with _regular(path).open("rb") as file:
        content = file.read(most_bytes + 1)
    if len(content) > most_bytes:
        raise ValueError(f"{path.name} is larger than {most_bytes} bytes")
    return content


def _regular(path: Path) -> Path:
    """Return the path of a file; raises ValueError for a pipe or a device, which might never end."""
    if not stat.S_ISREG(path.stat().st_mode):
        raise ValueError(f"{path.name} is no file")
    return path


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or f"{type(error).__name__}: {error}"
