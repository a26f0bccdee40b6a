"""Runs one method on one dataset: fit, encode, match and the stopwatch; keeps answers and times, judges nothing."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict
from functools import partial
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from vprbench import progress
from vprbench.api.arrays import Scores
from vprbench.api.checkpoints import ledger
from vprbench.api.dataset import Dataset
from vprbench.api.descriptor import DescriptorMethod
from vprbench.api.images import Images
from vprbench.api.method import Method, calibration, held_together
from vprbench.api.search import Audit, Search
from vprbench.errors import BadInput
from vprbench.metrics.ranking import Outcome, best_places, checked_scores, concatenate, outcome
from vprbench.plugins import networks
from vprbench.run import machine, spikes
from vprbench.run.data_record import data_record
from vprbench.run.descriptor_cache import DescriptorCache, Descriptors
from vprbench.run.descriptors import Described
from vprbench.run.fitting import learn
from vprbench.run.identity import Identity, code_hash
from vprbench.run.note import Note, noted
from vprbench.run.preprocessed import Preprocessed
from vprbench.run.record import Run
from vprbench.run.stopwatch import Protocol, Stopwatch, Timing, synchroniser

_BLOCK = 128  # queries scored together
_BLOCK_CELLS = 1 << 25  # scores of such a block
_RANKED_CELLS = 1 << 22  # scores whose best are looked for together: bounds the memory
_AUDITED = 256  # queries by which an approximate index is compared with exact search, at most
_SPIKING = 256  # queries whose spikes are counted, at most
_LARGEST_MATRIX = 10_000_000  # scores kept whole up to this number
_NOISE = 0.05  # drift of a fixed computation that marks a run as noisy
_BUSY = 15.0  # percent of CPU pressure that marks a run as noisy
_CACHING = 0.9  # known images that need less than this share of the time of new ones are suspicious
Answer = TypeVar("Answer")

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

    Where files lie does not count: of the module of the method's class its name alone.
    `network` is the hash of the file that the run loads; a run that trains has another key.
    """
    held_out = calibration(method, dataset)
    return Identity(
        type(method).__qualname__,
        code_hash(type(method)),
        config,
        dataset,
        fingerprint,
        None if held_out is None else held_out.fingerprint(),
        protocol,
        threads,
        network,
    ).key()


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
    cache: DescriptorCache | None = None,
    preprocessed: Preprocessed | None = None,
) -> Run:
    """Fit a method or load its network, score every query and measure its rates.

    `config` holds what was asked for (method, dataset, seed, device, depth), the run's also the hash of the code and
    the timing protocol; raises whatever the method raises.
    A network is stored before the first query; whether it can be is seen before it is trained. Descriptors worth
    keeping are kept in `cache` and taken from there; the sample that is timed is encoded in any case. `preprocessed`
    keeps the frames of a fit; what an earlier run spent on those that it has already counts as part of the fit.
    """
    device = config["device"]
    data = data_record(dataset)
    started = time.perf_counter()
    surroundings = machine.capture(device, threads)
    canary = machine.canary_seconds()
    stopwatch = Stopwatch(protocol, synchronise=synchroniser(device), seed=config["seed"])
    machine.reset_peak_memory()

    described = Described.of(cache if files.load is None else None, method, config)
    with ledger() as resumed:
        learnt = learn(stopwatch, method, dataset, config["method"], key, files, described, resumed, preprocessed)

        before = dataset.queries.reading.seconds
        answers = _Answers(dataset, config["depth"])
        audited = _Audited(method, len(dataset.queries))
        with stopwatch.lap() as querying:
            first_query = stopwatch.first_query(method, dataset.queries.unnamed())
            answers.method_seconds += first_query
            from_cache = _answer(stopwatch, method, dataset, described, answers, audited)
    harness = querying[0] - answers.method_seconds - (dataset.queries.reading.seconds - before)

    with stopwatch.lap() as measuring:
        timing = stopwatch.measure(method, dataset.queries.unnamed(), first_query)
    progress.report("timing", 1.0)

    pressure = machine.cpu_pressure()
    slowdown = machine.canary_seconds() / canary
    peak_memory_bytes = machine.peak_memory_bytes()
    device_memory_bytes = machine.peak_device_memory_bytes(device)
    with stopwatch.lap() as auditing:
        search = _search(method, audited)
        spiked, spike_notes = _spikes(method, dataset.queries)
    result = concatenate(answers.outcomes)
    return Run(
        method=name,
        dataset=dataset.name,
        key=key,
        config={**config, "code": code_hash(type(method)), "timing": asdict(protocol)},
        protocol=dataset.protocol,
        fingerprint=dataset_fingerprint,
        environment={
            **surroundings,
            "canary_slowdown": slowdown,
            "cpu_pressure_avg10_after": pressure,
            "device_memory_bytes": device_memory_bytes,
        },
        notes=(
            *noted("dataset", dataset.notes),
            *learnt.notes,
            *noted("method", method.notes()),
            *_cache_notes(dataset, learnt.from_cache, from_cache),
            *_late_notes(timing, learnt.fit_seconds is not None),
            *_notes(slowdown, pressure, timing, answers),
            *_search_notes(search),
            *spike_notes,
        ),
        n_references=len(dataset.references),
        fit_seconds=learnt.fit_seconds,
        fit_compute_seconds=learnt.fit_compute_seconds,
        load_seconds=learnt.load_seconds,
        network=files.sha256,
        search=search,
        peak_memory_bytes=peak_memory_bytes,
        harness_seconds=time.perf_counter()
        - started
        - learnt.seconds
        - querying[0]
        - measuring[0]
        - auditing[0]
        + harness,
        method_seconds=learnt.method_seconds + answers.method_seconds,
        timing=timing,
        outcome=result,
        positives=dataset.positives,
        place_numbers=dataset.place_numbers,
        top_places=np.concatenate(answers.top_places),
        top_scores=np.concatenate(answers.top_scores),
        scores=np.concatenate(answers.kept) if answers.kept else None,
        spikes=spiked,
        data=data,
    )


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
        if np.shape(scores) != wanted:
            raise BadInput(f"the method gave scores of shape {np.shape(scores)}; wanted {wanted}, one for each place")
        scores = checked_scores(scores, self.done)
        self.outcomes.append(outcome(scores, self._positives[self.done : self.done + len(scores)]))
        rows = max(1, _RANKED_CELLS // scores.shape[1])
        parts = [best_places(scores[first : first + rows], self._depth) for first in range(0, len(scores), rows)]
        best = np.concatenate(parts)
        values = np.take_along_axis(scores, best, axis=1)
        order = np.argsort(-values, axis=1, kind="stable")
        self.top_places.append(np.take_along_axis(best, order, axis=1).astype(np.int32))
        self.top_scores.append(np.take_along_axis(values, order, axis=1))
        if self._shape[0] * self._shape[1] <= _LARGEST_MATRIX:
            self.kept.append(scores.copy())  # a method may use its array again
        self.done += len(scores)
        self.method_seconds += seconds


class _Audited:
    """Keeps the codes of some queries, spread over all, by which an approximate index is compared with exact search."""

    def __init__(self, method: Method, n_queries: int) -> None:
        """Keep none where a fitted method does not search by an approximate index."""
        index = _index(method)
        wanted = 0 if index is None or index.kind == "exact" else held_together(method, min(_AUDITED, n_queries))
        self._queries = np.linspace(0, n_queries - 1, wanted).astype(np.int64)
        self.codes: list[npt.NDArray[Any]] = []

    def take(self, first: int, codes: npt.NDArray[Any]) -> None:
        """Keep those of `codes` that are wanted; they are of query `first` and the next ones."""
        rows = self._queries - first
        rows = rows[(rows >= 0) & (rows < len(codes))]
        if len(rows):
            self.codes.append(codes[rows])


def _block_size(method: Method, n_places: int) -> int:
    """Return how many queries are scored together at most, fewer where codes are large or places many."""
    return held_together(method, max(1, min(_BLOCK, _BLOCK_CELLS // n_places)))


def _timed(stopwatch: Stopwatch, call: Callable[[], Answer]) -> tuple[Answer, float]:
    with stopwatch.lap() as lap:
        answer = call()
    return answer, lap[0]


def _query(stopwatch: Stopwatch, method: Method, block: Images, audited: _Audited, first: int) -> tuple[Scores, float]:
    """Score images, of which the first is query `first`; their codes, which may be large, are not kept."""
    codes, encoding = _timed(stopwatch, partial(method.encode, block))
    audited.take(first, codes)
    scores, matching = _timed(stopwatch, partial(method.match, codes))
    return scores, encoding + matching


def _answer(
    stopwatch: Stopwatch,
    method: Method,
    dataset: Dataset,
    described: Described | None,
    answers: _Answers,
    audited: _Audited,
) -> bool:
    """Score the queries; returns whether that was done by descriptors that were kept already."""
    if described is not None:
        return _answer_from_descriptors(stopwatch, method, dataset, described, answers, audited)
    queries = dataset.queries.unnamed()
    for block in queries.blocks(_block_size(method, dataset.n_places)):
        answers.add(len(block), *_query(stopwatch, method, block, audited, answers.done))
        progress.report("query", answers.done / len(queries))
        del block  # or it would be held while the next one is decoded
    return False


def _answer_from_descriptors(
    stopwatch: Stopwatch,
    method: Method,
    dataset: Dataset,
    described: Described,
    answers: _Answers,
    audited: _Audited,
) -> bool:
    """Score the queries by descriptors that are kept; returns whether they were kept already."""
    queries = dataset.queries.unnamed()

    def encode(block: Images) -> Descriptors:
        codes, seconds = _timed(stopwatch, partial(method.encode, block))
        answers.method_seconds += seconds
        return np.asarray(codes)

    descriptors, from_cache = described.descriptors(
        queries, encode, lambda done: progress.report("query", done / len(queries))
    )
    size = _block_size(method, dataset.n_places)
    for start in range(0, len(queries), size):
        codes = descriptors[start : start + size]
        audited.take(answers.done, codes)
        answers.add(len(codes), *_timed(stopwatch, partial(method.match, codes)))
        progress.report("search", answers.done / len(queries))
    return from_cache


def _cache_notes(dataset: Dataset, references: bool, queries: bool) -> Iterator[Note]:
    """Yield what was not encoded because its descriptors were kept."""
    kept = [f"{len(dataset.references)} references"] * references + [f"{len(dataset.queries)} queries"] * queries
    if kept:
        nothing = "nothing was encoded" if references and queries else "none of these was encoded"
        yield Note(
            "described",
            f"descriptors of {' and '.join(kept)} were kept from an earlier run: {nothing} but the timed sample",
        )


def _late_notes(timing: Timing, trained: bool) -> Iterator[Note]:
    """Yield what the first query did that later ones do not."""
    if timing.first_query_excess_seconds:
        use = "what it took more counts as training" if trained else "no time holds it, for nothing was trained"
        seconds = timing.first_query_seconds
        times = seconds / float(np.median(timing.streaming.total_seconds))
        yield Note("late", f"late work: the first query took {seconds:.2f} s, {times:,.0f} times the median; {use}")


def _notes(slowdown: float, pressure: float | None, timing: Timing, answers: _Answers) -> Iterator[Note]:
    """Yield what a reader of the numbers has to know."""
    if abs(slowdown - 1) > _NOISE:
        yield Note("noisy", f"noisy: a fixed computation took {slowdown:.2f} times as long after the run as before")
    if pressure is not None and pressure > _BUSY:
        yield Note("noisy", f"noisy: processes waited for a core in {pressure:.0f} % of the last 10 s of timing")
    if not all(laps.valid for laps in (timing.streaming, *timing.offline)):
        yield Note(
            "invalid", "invalid rates: a minimum of the timing protocol was not met within timing.maximum_seconds"
        )
    if timing.repeated_seconds < _CACHING * timing.unseen_seconds:
        share = 100 * timing.repeated_seconds / timing.unseen_seconds
        yield Note("caching", f"caching: images seen before are answered in {share:.0f} % of the time of new ones")
    if not _same_answers(timing, answers):
        yield Note("audit", "audit failed: the timed run gave other answers than the scored run")


def _search(method: Method, audited: _Audited) -> dict[str, Any] | None:
    """Return what a method searches its descriptors by, and how much of what exact search finds that finds."""
    index = _index(method)
    if index is None or not isinstance(method, DescriptorMethod):
        return None
    audit = Audit(1.0, 1.0) if index.kind == "exact" else method.audit(np.concatenate(audited.codes))
    return {"index": index.kind, "bytes_per_place": index.bytes_per_place, **asdict(audit)}


def _index(method: Method) -> Search | None:
    return method.searched if isinstance(method, DescriptorMethod) else None


def _search_notes(search: Mapping[str, Any] | None) -> Iterator[Note]:
    """Yield how good an approximate index is."""
    if search is not None and search["index"] != "exact":
        yield Note(
            "index",
            f"index {search['index']}: {100 * search['recall_at_1']:.1f} % of the exactly best places found, "
            f"{100 * search['recall_at_10']:.1f} % of the best 10; {search['bytes_per_place']:,} bytes a place",
        )


def _spikes(method: Method, queries: Images) -> tuple[dict[str, Any] | None, tuple[Note, ...]]:
    """Return what the layers of a spiking network did for queries spread over all, and what went wrong meanwhile."""
    if type(method).spikes is Method.spikes:
        return None, ()
    wanted = held_together(method, min(_SPIKING, len(queries)))
    chosen = queries.unnamed()[np.linspace(0, len(queries) - 1, wanted).astype(np.int64)]
    try:
        blocks = chosen.blocks(_block_size(method, 1))
        codes = np.concatenate([np.array(method.encode(block)) for block in blocks])
        return spikes.summary(method.spikes(codes)), ()
    except Exception as error:  # a plug-in may fail in any way, and its answers and times still stand
        reason = " ".join(str(error).split())
        return None, (Note("spikes", f"no spikes were counted ({type(error).__name__}: {reason})"),)


def _same_answers(timing: Timing, answers: _Answers) -> bool:
    """Tell whether the places named in the timed run score best in the scored run too."""
    queries = timing.sample[timing.answers >= 0]
    named = timing.answers[timing.answers >= 0]
    places, scores = np.concatenate(answers.top_places)[queries], np.concatenate(answers.top_scores)[queries]
    largest = np.abs(scores).max(1, initial=0, where=scores > -np.inf, keepdims=True)
    close = scores >= scores[:, :1] - _SAME_SCORE * largest
    return bool(((places == named[:, None]) & close).any(axis=1).all())
