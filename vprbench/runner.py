"""Runs one method on one dataset: fit, encode, match and the stopwatch; keeps answers and times, judges nothing."""

from __future__ import annotations

import hashlib
import inspect
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench import environment, networks, preprocess_compiled, progress
from vprbench.images import Images
from vprbench.interface import BadInput, Dataset, Method, Places, Scores
from vprbench.preprocess import PatchNormalisation
from vprbench.ranking import Outcome, checked_scores, concatenate, outcome
from vprbench.records import Run, content_key
from vprbench.stopwatch import Protocol, Stopwatch, Timing, synchroniser

_BLOCK = 128  # queries scored together
_BLOCK_BYTES = 1 << 28  # of decoded images in such a block
_LARGEST_MATRIX = 10_000_000  # scores kept whole up to this number
_NOISE = 0.05  # drift of a fixed computation that marks a run as noisy
_BUSY = 15.0  # percent of CPU pressure that marks a run as noisy
_CACHING = 0.75  # known images that need less than this share of the time of new ones are suspicious
_NO_FILES = networks.Files()  # a run that neither loads nor stores a network
_SAME_SCORE = 1e-4  # relative difference that counts as the same answer in the timed and in the scored run


def run_key(
    method: Method,
    config: Mapping[str, Any],
    dataset: Dataset,
    fingerprint: str,
    protocol: Protocol,
    threads: int,
    network: str | None = None,
) -> str:
    """Return the hash of all that can change the outcome of a run or the times it measures.

    `network` is the hash of the file that the run loads; a run that trains has another key.
    """
    arguments = {name: value for name, value in config["method"].items() if name != "device"}
    return content_key(
        {
            "method": arguments,
            "code": code_hash(type(method)),
            "dataset": dataset.name,
            "protocol": dict(dataset.protocol),
            "images": fingerprint,
            "seed": config["seed"],
            "device": environment.device_class(config["device"]),
            "threads": threads,
            "depth": config["depth"],
            "timing": asdict(protocol),
            "libraries": environment.library_versions(),
            "network": network,
        }
    )


def code_hash(method: type[Method]) -> str:
    """Return the hash of the source behind a method: its folder (in `methods/`, its file) and what all methods use."""
    own = Path(inspect.getfile(method))
    package = method.__module__.rpartition(".")[0]
    sources = [own] if package in ("", "vprbench.methods") else sorted(own.parent.rglob("*.py"))
    parts = (Method, Images, PatchNormalisation, Outcome, Stopwatch, networks.load, run)
    sources += [Path(inspect.getfile(part)) for part in parts]
    sources.append(Path(preprocess_compiled.__file__))
    digest = hashlib.sha256()
    for source in sources:
        digest.update(source.read_bytes())
    return digest.hexdigest()


def fingerprint(dataset: Dataset) -> str:
    """Return the hash of a dataset's images, order and ground truth."""
    digest = hashlib.sha256()
    digest.update(dataset.references.fingerprint().encode())
    digest.update(dataset.queries.fingerprint().encode())
    digest.update(dataset.places.tobytes())
    for right in dataset.positives:
        digest.update(right.tobytes() + b";")
    return digest.hexdigest()


def run(
    name: str,
    method: Method,
    dataset: Dataset,
    config: Mapping[str, Any],
    key: str,
    dataset_fingerprint: str,
    protocol: Protocol,
    threads: int,
    files: networks.Files = _NO_FILES,
) -> Run:
    """Fit a method or load its network, score every query and measure its rates.

    `config` holds what was asked for (method, dataset, seed, device, depth); raises whatever the method raises.
    A network is stored before the first query; whether it can be is seen before it is trained.
    """
    device = config["device"]
    started = time.perf_counter()
    surroundings = environment.capture(device, threads)
    canary = environment.canary_seconds()
    stopwatch = Stopwatch(protocol, synchronise=synchroniser(device), seed=config["seed"])
    environment.reset_peak_memory()

    learnt = _learn(stopwatch, method, dataset, config["method"], key, files)

    before = dataset.queries.reading.seconds
    answers = _Answers(dataset, config["depth"])
    with stopwatch.lap() as querying:
        for block in dataset.queries.unnamed().blocks(_block_size(dataset.queries)):
            answers.add(len(block), *_timed_scores(stopwatch, method, block))
            progress.report("query", answers.done / len(dataset.queries))
    harness = querying[0] - answers.method_seconds - (dataset.queries.reading.seconds - before)

    with stopwatch.lap() as measuring:
        timing = stopwatch.measure(method, dataset.queries.unnamed())
    progress.report("timing", 1.0)

    pressure = environment.cpu_pressure()
    slowdown = environment.canary_seconds() / canary
    result = concatenate(answers.outcomes)
    return Run(
        method=name,
        dataset=dataset.name,
        key=key,
        config=config,
        protocol=dataset.protocol,
        fingerprint=dataset_fingerprint,
        environment={
            **surroundings,
            "canary_slowdown": slowdown,
            "cpu_pressure_avg10_after": pressure,
            "device_memory_bytes": environment.peak_device_memory_bytes(device),
        },
        notes=(*learnt.notes, *_notes(slowdown, pressure, timing, answers)),
        n_references=len(dataset.references),
        fit_seconds=learnt.fit_seconds,
        fit_compute_seconds=learnt.fit_compute_seconds,
        load_seconds=learnt.load_seconds,
        network=files.sha256,
        peak_memory_bytes=environment.peak_memory_bytes(),
        harness_seconds=time.perf_counter() - started - learnt.seconds - querying[0] - measuring[0] + harness,
        method_seconds=learnt.method_seconds + answers.method_seconds,
        timing=timing,
        outcome=result,
        positives=dataset.positives,
        top_places=np.concatenate(answers.top_places),
        top_scores=np.concatenate(answers.top_scores),
        scores=np.concatenate(answers.kept) if answers.kept else None,
    )


@dataclass(frozen=True)
class _Learnt:
    """How a method came to its map, and how long that took."""

    fit_seconds: float | None = None
    fit_compute_seconds: float | None = None
    load_seconds: float | None = None
    notes: tuple[str, ...] = ()

    @property
    def seconds(self) -> float:
        """Return the wall time."""
        return (self.fit_seconds or 0.0) + (self.load_seconds or 0.0)

    @property
    def method_seconds(self) -> float:
        """Return the time that went into the method."""
        return (self.fit_compute_seconds or 0.0) + (self.load_seconds or 0.0)


def _learn(
    stopwatch: Stopwatch,
    method: Method,
    dataset: Dataset,
    arguments: Mapping[str, Any],
    key: str,
    files: networks.Files,
) -> _Learnt:
    """Load the method's network, or fit the method and store its network where that was asked for."""
    if files.load is not None:
        progress.report("load", 0.0)
        wanted = networks.origin(method, arguments, dataset)
        with stopwatch.lap() as load:
            notes = networks.load(files.load, method, wanted, files.sha256)
        return _Learnt(load_seconds=load[0], notes=notes)
    destination = networks.prepare(files, method, arguments, dataset)
    before = dataset.references.reading.seconds
    progress.report("fit", 0.0)
    with stopwatch.lap() as fit:
        method.fit(dataset.references.watched(_reading(len(dataset.references))), _read_only(dataset.places))
    computing = fit[0] - (dataset.references.reading.seconds - before)
    if destination is not None:
        networks.save(destination, method, key, fit[0], computing)
    return _Learnt(fit_seconds=fit[0], fit_compute_seconds=computing)


class _Answers:
    """Collects a method's answers block by block, in bounded memory."""

    def __init__(self, dataset: Dataset, depth: int) -> None:
        """Keep the best `depth` places of each query, and all scores where they are few."""
        self._positives = dataset.positives
        self._depth = min(depth, dataset.n_places)
        self._shape = (len(dataset.queries), dataset.n_places)
        self.done = 0
        self.method_seconds = 0.0
        self.outcomes: list[Outcome] = []
        self.top_places: list[npt.NDArray[np.int32]] = []
        self.top_scores: list[Scores] = []
        self.kept: list[Scores] = []

    def add(self, n_queries: int, scores: Scores, seconds: float) -> None:
        """Take the scores of the next queries; raises BadInput for scores of a wrong shape or kind."""
        wanted = (n_queries, self._shape[1])
        if scores.shape != wanted:
            raise BadInput(f"the method gave scores of shape {scores.shape}; wanted {wanted}, one for each place")
        scores = checked_scores(scores, self.done)
        self.outcomes.append(outcome(scores, self._positives[self.done : self.done + len(scores)]))
        best = _best_places(scores, self._depth)
        values = np.take_along_axis(scores, best, axis=1)
        order = np.argsort(-values, axis=1, kind="stable")
        self.top_places.append(np.take_along_axis(best, order, axis=1).astype(np.int32))
        self.top_scores.append(np.take_along_axis(values, order, axis=1))
        if self._shape[0] * self._shape[1] <= _LARGEST_MATRIX:
            self.kept.append(scores)
        self.done += len(scores)
        self.method_seconds += seconds


def _best_places(scores: Scores, depth: int) -> npt.NDArray[np.int64]:
    """Return the `depth` best places of each query in ascending order, (n_queries, depth); of equals the lower ones."""
    worst = np.partition(scores, -depth, axis=1)[:, -depth, None]
    better, equal = scores > worst, scores == worst
    room = depth - np.count_nonzero(better, axis=1, keepdims=True)
    chosen = better | (equal & (np.cumsum(equal, axis=1) <= room))
    return np.nonzero(chosen)[1].reshape(len(scores), depth)


def _reading(total: int) -> Callable[[int], None]:
    """Return what reports how many references a fit has read, as a stage of its own."""
    return lambda done: progress.report("fit, reading images", done / total)


def _block_size(queries: Images) -> int:
    """Return how many queries are decoded and scored together, fewer where they are large."""
    return max(1, min(_BLOCK, _BLOCK_BYTES // queries[0].nbytes))


def _timed_scores(stopwatch: Stopwatch, method: Method, block: Images) -> tuple[Scores, float]:
    with stopwatch.lap() as lap:
        scores = method.query(block)
    return scores, lap[0]


def _read_only(places: Places) -> Places:
    view = places.view()
    view.flags.writeable = False
    return view


def _notes(slowdown: float, pressure: float | None, timing: Timing, answers: _Answers) -> Iterator[str]:
    """Yield what a reader of the numbers has to know."""
    if abs(slowdown - 1) > _NOISE:
        yield f"noisy: a fixed computation took {slowdown:.2f} times as long after the run as before"
    if pressure is not None and pressure > _BUSY:
        yield f"noisy: processes waited for a core in {pressure:.0f} % of the last 10 s of timing"
    if not all(laps.valid for laps in (timing.streaming, *timing.offline)):
        yield "invalid rates: a minimum of the timing protocol was not met within timing.maximum_seconds"
    if timing.repeated_seconds < _CACHING * timing.unseen_seconds:
        yield "caching: images seen before are answered much faster than new ones"
    if not _same_answers(timing, answers):
        yield "audit failed: the timed run gave other answers than the scored run"


def _same_answers(timing: Timing, answers: _Answers) -> bool:
    """Tell whether the places named in the timed run score best in the scored run too."""
    queries = timing.sample[timing.answers >= 0]
    named = timing.answers[timing.answers >= 0]
    places, scores = np.concatenate(answers.top_places)[queries], np.concatenate(answers.top_scores)[queries]
    close = scores >= scores[:, :1] - _SAME_SCORE * np.abs(scores).max(1, keepdims=True)
    return bool(((places == named[:, None]) & close).any(axis=1).all())
