"""One finished run, and the store of runs on disk: atomic, checked, without pickle."""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
import os
import shutil
import socket
import uuid
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import psutil

from vprbench.interface import BadInput
from vprbench.ranking import Outcome
from vprbench.replacing import move_folder
from vprbench.stopwatch import Laps, Timing, plain

logger = logging.getLogger(__name__)

SCHEMA = 6
_SUMMARY, _ARRAYS, _SCORES, _FAILURE = "run.json", "arrays.npz", "scores.npy", "failure.json"
_PARTIAL = ".partial-"
_DAMAGED = ".damaged"
_FAILURE_KEYS = 3  # the layout whose number is in the key of a failure: what failed under it is still found


class DamagedRunError(Exception):
    """A folder of the store does not hold a whole run; the message says what is wrong with it."""


class NewerLayoutError(Exception):
    """A folder of the store holds a run of a later version of this program; the message names both."""


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
    notes: tuple[str, ...]  # what a reader of the numbers has to know: a noisy machine, an audit that failed
    n_references: int
    fit_seconds: float | None  # wall time, reading the images included; None: a network or descriptors were loaded
    fit_compute_seconds: float | None  # without the time that the method waited for images
    load_seconds: float | None  # wall time of reading, checking and restoring those
    network: str | None  # SHA-256 of the file that was loaded
    search: Mapping[str, Any] | None  # of descriptors: index, bytes_per_place, recall_at_1, recall_at_10; None: no such
    peak_memory_bytes: int
    harness_seconds: float  # spent neither in the method nor in reading images
    method_seconds: float  # spent in the method
    timing: Timing
    outcome: Outcome
    positives: tuple[npt.NDArray[np.int64], ...]  # per query the right places
    top_places: npt.NDArray[np.int32]  # (n_queries, depth), best first
    top_scores: npt.NDArray[np.float32]  # (n_queries, depth); -inf: no candidate
    scores: npt.NDArray[np.float32] | None  # (n_queries, n_places) where that is small enough to keep
    spikes: Mapping[str, Any] | None = None  # of a spiking network, over a sample of the queries
    place_numbers: npt.NDArray[np.int64] | None = None  # (n_places,), along the journey; None: 0, 1, 2 ...
    data: Mapping[str, Any] = field(default_factory=dict)  # data_record(dataset); empty in older runs
    tuned_on: Mapping[str, Any] | None = field(default_factory=dict)  # TunedOn; empty: nothing; None: older runs


@dataclass(frozen=True)
class Failure:
    """A run that ended without a result."""

    method: str
    dataset: str
    config: Mapping[str, Any]
    error: str
    environment: Mapping[str, Any] = field(default_factory=dict)  # of the machine; empty in older records
    missing: bool = False  # weights, frames or the method itself are not there: nothing was tried


def content_key(content: Mapping[str, Any]) -> str:
    """Return the hash of plain values: of all that can change an outcome, or of a summary itself."""
    text = json.dumps({"schema": SCHEMA, **content}, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


class Store:
    """A results folder: `<dataset>/<method>-<key>/` holds one run. Several processes may write to it at once."""

    def __init__(self, root: Path, read_only: bool = False) -> None:
        """Use the folder `root`, where nothing is written yet, or never where it is only read."""
        self.root = root
        self.read_only = read_only

    def prepare(self) -> None:
        """Make the folder and see that it can be written; raises BadInput before work is wasted on a run."""
        self._insist_on_writing()
        try:
            self.root.mkdir(parents=True, exist_ok=True)
            self._remove_leftovers()
            self._partial().rmdir()
        except OSError as error:
            raise BadInput(
                f"results={self.root} cannot be written ({error.strerror or error}): "
                "choose another folder with results=..."
            ) from error

    def folder(self, dataset: str, method: str, key: str) -> Path:
        """Return where a run with this key lies, or would lie."""
        return self.root / dataset / f"{method}-{key}"

    def find(self, dataset: str, method: str, key: str) -> Run | None:
        """Return the stored run with this key; a damaged one is set aside by name and counts as absent."""
        return self._load(self.folder(dataset, method, key))

    def runs(self) -> Iterator[Run]:
        """Yield every whole run; damaged ones are named and set aside, and never keep the others from being read."""
        for folder in self._folders():
            if (folder / _SUMMARY).exists():
                run = self._load(folder)
                if run is not None:
                    yield run

    def failures(self) -> Iterator[Failure]:
        """Yield every stored failure; a damaged one is named in a warning and left out."""
        for folder in self._folders():
            failure = _read_failure(folder)
            if failure is not None:
                yield failure

    def save(self, run: Run) -> Path:
        """Store a run, replacing one with the same key; raises BadInput where the disk refuses."""
        self._insist_on_writing()
        folder = self.folder(run.dataset, run.method, run.key)
        try:
            partial = self._partial()
            try:
                _write(run, partial)
                move_folder(partial, folder)
            finally:
                shutil.rmtree(partial, ignore_errors=True)
            shutil.rmtree(self._failure_folder(run.method, run.dataset, run.config), ignore_errors=True)
        except OSError as error:
            raise BadInput(
                f"the run could not be stored in {folder} ({error.strerror or error}): nothing was left there; "
                "make room or choose another folder with results=..."
            ) from error
        return folder

    def save_failure(self, failure: Failure) -> Path:
        """Store that a run ended in an error, until a run of the same configuration succeeds."""
        self._insist_on_writing()
        folder = self._failure_folder(failure.method, failure.dataset, failure.config)
        try:
            partial = self._partial()
            try:
                _write_json(partial / _FAILURE, asdict(failure))
                move_folder(partial, folder)
            finally:
                shutil.rmtree(partial, ignore_errors=True)
        except OSError as error:
            raise BadInput(f"the failure could not be stored in {folder} ({error.strerror or error})") from error
        return folder

    def failure(self, method: str, dataset: str, config: Mapping[str, Any]) -> Failure | None:
        """Return how the last run of this configuration failed, None if it did not."""
        return _read_failure(self._failure_folder(method, dataset, config))

    def _folders(self) -> list[Path]:
        """Return the folders of all datasets, by dataset and name."""
        return [folder for dataset in _visible(self.root) for folder in _visible(dataset)]

    def _insist_on_writing(self) -> None:
        if self.read_only:
            raise RuntimeError(f"the store {self.root} was opened to be read only")

    def _load(self, folder: Path) -> Run | None:
        """Read a run; a damaged one is set aside, one that another process replaces meanwhile is read again."""
        while (before := _identity(folder)) is not None:
            try:
                return load(folder)
            except NewerLayoutError as error:
                logger.warning("%s is left as it is: %s", folder, error)
                return None
            except DamagedRunError as error:
                if _identity(folder) == before:
                    self._set_aside(folder, str(error))
                    return None
        return None

    def _failure_folder(self, method: str, dataset: str, config: Mapping[str, Any]) -> Path:
        asked = {name: config.get(name) for name in ("method", "dataset", "seed", "device", "load")}
        return self.root / dataset / f"{method}-failed-{content_key({'schema': _FAILURE_KEYS, **asked})}"

    def _partial(self) -> Path:
        """Make a folder that no reader looks at, named after this process."""
        folder = self.root / f"{_PARTIAL}{socket.gethostname()}-{os.getpid()}-{uuid.uuid4().hex[:8]}"
        folder.mkdir()
        return folder

    def _remove_leftovers(self) -> None:
        """Remove what killed processes of this machine left unfinished."""
        prefix = f"{_PARTIAL}{socket.gethostname()}-"
        for folder in self.root.glob(f"{prefix}*"):
            pid = folder.name.removeprefix(prefix).split("-")[0]
            if pid.isdigit() and not psutil.pid_exists(int(pid)):
                with contextlib.suppress(NewerLayoutError):  # the program that wrote it knows what to do
                    self._put_back(folder)
                    shutil.rmtree(folder, ignore_errors=True)

    def _put_back(self, folder: Path) -> None:
        """Return a run whose replacement never arrived to its place."""
        if "-replaced-" in folder.name:
            with contextlib.suppress(DamagedRunError, OSError):  # damaged, or replaced after all
                run = load(folder)
                folder.rename(self.folder(run.dataset, run.method, run.key))

    def _set_aside(self, folder: Path, reason: str) -> None:
        if self.read_only:
            logger.warning("%s cannot be used (%s)", folder, reason)
            return
        aside = folder.with_name(f"{_DAMAGED}-{folder.name}-{uuid.uuid4().hex[:8]}")
        try:
            folder.rename(aside)
        except OSError:
            logger.warning("%s cannot be used (%s) and could not be set aside", folder, reason)
        else:
            logger.warning("%s cannot be used (%s): set aside as %s", folder, reason, aside.name)


def load(folder: Path) -> Run:
    """Read a run of this or an earlier layout; what that did not hold yet is None, or empty.

    Raises DamagedRunError where a part is missing or changed, NewerLayoutError for a layout that is not known yet.
    """
    try:
        summary = json.loads((folder / _SUMMARY).read_text(encoding="utf-8"))
        layout = summary["schema"]
        if layout > SCHEMA:
            raise NewerLayoutError(f"its layout is version {layout}, this program reads 1 to {SCHEMA}")
        if (layout > 1 or "content_key" in summary) and summary.pop("content_key") != content_key(summary):
            raise DamagedRunError(f"{_SUMMARY} is not what was written")
        summary = {**{name: empty for name, (first, empty) in _ADDED.items() if layout < first}, **summary}
        _name_protocol(summary)
        for name, digest in summary["sha256"].items():
            if _digest(folder / name) != digest:
                raise DamagedRunError(f"{name} is not what was written")
        with np.load(folder / _ARRAYS, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        scores = np.load(folder / _SCORES, mmap_mode="r", allow_pickle=False) if _SCORES in summary["sha256"] else None
        return _from_parts(summary, arrays, scores)
    except (DamagedRunError, NewerLayoutError):
        raise
    except (OSError, ValueError, KeyError, TypeError, AttributeError, EOFError) as error:
        raise DamagedRunError(f"{type(error).__name__}: {error}") from error


_OUTCOME = [field.name for field in fields(Outcome) if field.name != "n_places"]
_PLAIN = (
    "method",
    "dataset",
    "key",
    "config",
    "protocol",
    "fingerprint",
    "environment",
    "n_references",
    "fit_seconds",
    "fit_compute_seconds",
    "load_seconds",
    "network",
    "search",
    "peak_memory_bytes",
    "harness_seconds",
    "method_seconds",
    "spikes",
    "data",
    "tuned_on",
)
_WITH_PROTOCOLS = frozenset(  # datasets that came to have two
    f"vprbench.datasets.{name}.{name}" for name in ("nordland", "oxford_robotcar", "street", "synthetic")
)
_ADDED: Mapping[str, tuple[int, Any]] = {  # the layout that first held it, and what stands for it in earlier ones
    "load_seconds": (2, None),
    "network": (2, None),
    "search": (3, None),
    "spikes": (4, None),
    "data": (5, {}),
    "tuned_on": (6, None),
}


def _name_protocol(content: dict[str, Any]) -> None:
    """Name the protocol of a run or failure that was stored when its dataset had only one, VPRTempo's."""
    dataset = content["config"].get("dataset", {})
    if dataset.get("_target_") not in _WITH_PROTOCOLS or "protocol" in dataset:
        return
    content["config"] = {**content["config"], "dataset": {**dataset, "protocol": "vprtempo"}}
    if "protocol" in content:
        recorded = content["protocol"]
        counts = {"reference_places": "places", "held_out_places": "first_query_place"}
        follow = {name: recorded[same] for name, same in counts.items() if same in recorded}
        content["protocol"] = {"protocol": "vprtempo", **recorded, **follow}


def _write(run: Run, folder: Path) -> None:
    laps = {"streaming": run.timing.streaming}
    laps |= {f"offline_{number}": laps for number, laps in enumerate(run.timing.offline)}
    arrays = {name: getattr(run.outcome, name) for name in _OUTCOME}
    arrays |= {f"{name}_encode_seconds": lap.encode_seconds for name, lap in laps.items()}
    arrays |= {f"{name}_match_seconds": lap.match_seconds for name, lap in laps.items()}
    arrays |= {
        "sample": run.timing.sample,
        "answers": run.timing.answers,
        "top_places": run.top_places,
        "top_scores": run.top_scores,
        "positives": np.concatenate([np.empty(0, np.int64), *run.positives]),
        "positives_per_query": np.array([len(right) for right in run.positives]),
    }
    if run.place_numbers is not None:
        arrays["place_numbers"] = run.place_numbers
    np.savez_compressed(folder / _ARRAYS, allow_pickle=False, **arrays)
    if run.scores is not None:
        np.save(folder / _SCORES, run.scores, allow_pickle=False)
    summary = {name: getattr(run, name) for name in _PLAIN}
    summary |= {
        "schema": SCHEMA,
        "notes": list(run.notes),
        "n_places": run.outcome.n_places,
        "timing": plain(run.timing),
        "sha256": {path.name: _digest(path) for path in sorted(folder.iterdir())},
    }
    _write_json(folder / _SUMMARY, {**summary, "content_key": content_key(summary)})


def _from_parts(
    summary: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]], scores: npt.NDArray[np.float32] | None
) -> Run:
    def laps(name: str, images_per_call: int, valid: bool) -> Laps:
        return Laps(arrays[f"{name}_encode_seconds"], arrays[f"{name}_match_seconds"], images_per_call, valid)

    timing = summary["timing"]
    ends = np.cumsum(arrays["positives_per_query"])[:-1]
    return Run(
        **{name: summary[name] for name in _PLAIN},
        notes=tuple(summary["notes"]),
        timing=Timing(
            timing["first_query_seconds"],
            timing["warmup_queries"],
            laps("streaming", 1, timing["streaming_valid"]),
            tuple(
                laps(f"offline_{number}", lap["images_per_call"], lap["valid"])
                for number, lap in enumerate(timing["offline"])
            ),
            arrays["sample"],
            arrays["answers"],
            timing["repeated_seconds"],
            timing.get("unseen_seconds", 0.0),  # the first runs lack it
        ),
        outcome=Outcome(**{name: arrays[name] for name in _OUTCOME}, n_places=summary["n_places"]),
        positives=tuple(np.split(arrays["positives"], ends)),
        top_places=arrays["top_places"],
        top_scores=arrays["top_scores"],
        scores=scores,
        place_numbers=arrays.get("place_numbers"),
    )


def _read_failure(folder: Path) -> Failure | None:
    """Read a failure, of an earlier or later version too; None where there is none or, with a warning, none whole."""
    try:
        content = json.loads((folder / _FAILURE).read_text("utf-8"))
        _name_protocol(content)
        return Failure(**{part.name: content[part.name] for part in fields(Failure) if part.name in content})
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        logger.warning("%s cannot be read (%s)", folder / _FAILURE, error)
        return None


def _write_json(path: Path, content: Mapping[str, Any]) -> None:
    with path.open("x", encoding="utf-8") as file:
        json.dump(content, file, indent=1)
        file.flush()
        os.fsync(file.fileno())


def _visible(folder: Path) -> list[Path]:
    """Return the folders in a folder, by name, without those that no reader looks at."""
    try:
        return sorted(path for path in folder.iterdir() if not path.name.startswith(".") and path.is_dir())
    except FileNotFoundError:
        return []


def _identity(folder: Path) -> tuple[int, int] | None:
    """Return what tells a folder from its replacement of the same name; None where there is none."""
    try:
        found = folder.stat()
    except FileNotFoundError:
        return None
    return found.st_ino, found.st_mtime_ns  # a number may be used again


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
