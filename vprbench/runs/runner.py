"""Runs one method on one dataset: fit, encode, match and the stopwatch; keeps answers and times, judges nothing."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from vprbench import progress
from vprbench.api.dataset import Dataset
from vprbench.plugins.opened_files import OpenedFile, find_unnamed_files, record_opened_files
from vprbench.runs import machine, spikes, timing_lock
from vprbench.runs.adapted import describe_adaptation
from vprbench.runs.answers import Answers, Scoring
from vprbench.runs.descriptors import DescriptorCache
from vprbench.runs.fitting import FitResult, fit_or_load
from vprbench.runs.identity import Request, code_hash, data_record
from vprbench.runs.notes import Note, noted
from vprbench.runs.record import Run
from vprbench.runs.stopwatch import Stopwatch, Timing, synchroniser
from vprbench.runs.viewpoints import Viewpoints
from vprbench.text import be, some

_NOISE = 0.05  # drift of a fixed computation that marks a run as noisy
_BUSY = 15.0  # percent of CPU pressure that marks a run as noisy
_SAME_SCORE = 1e-4  # relative difference that counts as the same answer in the timed and in the scored run


@timing_lock.computing()
def run(request: Request, key: str, keep: Callable[[Run], None] = lambda run: None) -> Run:
    """Fit a method or load its network, score every query and measure its rates; `key` identifies the run.

    `keep` is given the run without its rates before these are measured, unless none are asked for. Raises whatever the
    method raises. A network is stored before the first query; whether it can be is seen before it is trained. What is
    timed is encoded, and never taken from the request's cache of descriptors.
    """
    method, dataset, device = request.method, request.dataset, request.config["device"]
    queries = dataset.queries.unnamed()
    data = request.data or data_record(dataset)
    started = time.perf_counter()
    watch = _Watch(device, request.threads)
    stopwatch = Stopwatch(request.protocol, synchronise=synchroniser(device), seed=request.config["seed"])

    cache = request.cache if request.files.load is None else None
    described = DescriptorCache.of(cache, method, request.config, dataset.n_places)
    with record_opened_files() as opened:
        fitted = fit_or_load(request, key, stopwatch, described)
        read = queries.reading.seconds
        scoring = Scoring(stopwatch, method, dataset, request.config["depth"], request.scores)
        answers = scoring.answers
        if request.views is not None:
            scoring.look_from(request.views.all, request.method)
        first_query = stopwatch.first_query(scoring.begin_traverse(), queries)
        watch.fitted()
        answers.method_seconds += first_query
        from_cache = scoring.score(described if request.views is None else None)
        elsewhere = fitted.seconds + answers.method_seconds + queries.reading.seconds - read

    measured = {"data": data, **watch.seen()}
    with stopwatch.lap() as auditing:
        counted, spike_notes = spikes.counted(method, queries)
        measured |= {"search": scoring.audited.search(), "spikes": counted}
    told = (
        *noted("dataset", dataset.notes),
        *fitted.notes,
        *noted("method", method.notes()),
        *_opened_notes(request, opened),
        *_cache_notes(dataset, fitted.from_cache, from_cache),
        *scoring.notes(),
        *describe_adaptation(method),
        *noted("views", [] if request.views is None else [_describe_views(request.views)]),
    )
    scored = replace(
        _scored(request, key, fitted, answers, measured),
        harness_seconds=time.perf_counter() - started - elsewhere - auditing[0],
    )
    scored = replace(scored, notes=(*told, *_notes_on(scored), *spike_notes))
    if not request.protocol.rates:
        return scored
    keep(scored)
    with watch.alone():
        timing = stopwatch.measure(scoring.begin_traverse(), queries, first_query)
        timed = replace(scored, timing=timing, **watch.seen())
    progress.report("timing", 1.0)
    timed = replace(timed, config={**scored.config, "timing": asdict(request.protocol)})
    return replace(timed, notes=(*told, *_notes_on(timed), *spike_notes))


def _describe_views(views: Viewpoints) -> str:
    """Return a note on the viewpoints of each query."""
    shown = ", ".join(map(str, views.all))
    return f"asked from {len(views.all)} viewpoints, shifts in widths of the frame (/heights): {shown}"


class _Watch:
    """Looks at the machine before and after, and at the most memory in between; audits in the middle do not count."""

    def __init__(self, device: str, threads: int) -> None:
        self._device = device
        self._undisturbed = timing_lock.undisturbed()
        self._before = machine.capture(device, threads)
        self._canary_seconds = machine.canary_seconds()
        self._peaks: list[tuple[int, int | None]] = []
        self._is_timed = False
        self._waited: tuple[float, float] | None = None
        machine.reset_peak_memory(device)

    def fitted(self) -> None:
        """See whether the method was fitted, and asked for the first time, while no other run went on here."""
        self._before |= {"fitted_alone": self._undisturbed()}

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Look again once no other run goes on here; if others did until now, look as if for the first time."""
        was_alone = self._undisturbed()
        if not was_alone:
            progress.report("waiting to be timed", 0.0)
        with timing_lock.alone():
            self._is_timed = True
            if not was_alone:
                self._canary_seconds, self._waited = machine.canary_seconds(), machine.cpu_waited()
            machine.reset_peak_memory(self._device)
            yield

    def seen(self) -> dict[str, Any]:
        """Return what a run records of it all: `environment` and `peak_memory_bytes`."""
        after: dict[str, Any] = {
            "canary_slowdown": machine.canary_seconds() / self._canary_seconds,
            "cpu_pressure_avg10_after": machine.cpu_pressure(),
        }
        if self._is_timed:
            after["timed_alone"] = True
        if self._waited is not None:
            after["cpu_pressure_timed"] = machine.cpu_pressure_since(self._waited)
        self._peaks.append((machine.peak_memory_bytes(), machine.peak_device_memory_bytes(self._device)))
        host, on_device = zip(*self._peaks, strict=True)
        after["device_memory_bytes"] = max((peak for peak in on_device if peak is not None), default=None)
        return {"environment": {**self._before, **after}, "peak_memory_bytes": max(host)}


def _scored(request: Request, key: str, fitted: FitResult, answers: Answers, measured: Mapping[str, Any]) -> Run:
    """Return the record of a run that is not timed, but for its notes and `harness_seconds`."""
    dataset = request.dataset
    return Run(
        method=request.name,
        dataset=dataset.name,
        key=key,
        config={**request.config, "code": code_hash(type(request.method)), "timing": None},
        protocol=dataset.protocol,
        fingerprint=request.fingerprint,
        notes=(),
        n_references=len(dataset.references),
        fit_seconds=fitted.fit_seconds,
        fit_compute_seconds=fitted.fit_compute_seconds,
        load_seconds=fitted.load_seconds,
        network=request.files.sha256,
        harness_seconds=0.0,
        method_seconds=fitted.method_seconds + answers.method_seconds,
        timing=None,
        outcome=answers.outcome,
        positives=dataset.positives,
        place_numbers=dataset.place_numbers,
        query_breaks=dataset.query_breaks,
        place_breaks=dataset.place_breaks,
        top_places=answers.top_places,
        top_scores=answers.top_scores,
        scores=answers.scores,
        **measured,
    )


def _opened_notes(request: Request, opened: Iterable[OpenedFile]) -> Iterator[Note]:
    """Yield a note on the files that a method read and that are no part of the key."""
    known = {name for name, _ in request.config.get("files", ())}
    if others := [path.name for path in find_unnamed_files(opened, request.method) if path.name not in known]:
        text = f"read {some(others)}, which files() does not name: this run is found again whatever {be(others)} in it"
        yield Note("opened", text)


def _cache_notes(dataset: Dataset, references: int, queries: int) -> Iterator[Note]:
    """Yield how many descriptors were not encoded because they were kept."""
    traverses = (("references", references, len(dataset.references)), ("queries", queries, len(dataset.queries)))
    kept = [f"{n if n == of else f'{n} of {of}'} {images}" for images, n, of in traverses if n]
    if kept:
        everything = all(n == of for _, n, of in traverses)
        nothing = "nothing was encoded" if everything else "none of these was encoded"
        text = f"descriptors of {' and '.join(kept)} were kept from an earlier run: {nothing} but the timed sample"
        yield Note("described", text)


def _notes_on(run: Run) -> Iterator[Note]:
    """Yield what a reader of a run's times and answers has to know."""
    around = run.environment
    slowdown, pressure = around["canary_slowdown"], around["cpu_pressure_avg10_after"]
    window = "of the last 10 s of the run"
    if around.get("cpu_pressure_timed") is not None:
        pressure, window = around["cpu_pressure_timed"], "of the time in which it was timed"
    if abs(slowdown - 1) > _NOISE:
        yield Note("noisy", f"noisy: a fixed computation took {slowdown:.2f} times as long after the run as before")
    if pressure is not None and pressure > _BUSY:
        yield Note("noisy", f"noisy: processes waited for a core in {pressure:.0f} % {window}")
    if not around.get("fitted_alone", True):
        yield Note("fitted", "fitted beside other runs, which made it slower")
    if run.timing is not None:
        yield from _notes_on_rates(run, run.timing)
    if run.search is not None and run.search["index"] != "exact":
        found = run.search
        again = f", the best {found['rerank']} compared again" if found["rerank"] else ""
        yield Note(
            "index",
            f"index {found['index']}{again}: {100 * found['recall_at_1']:.1f} % of the exactly best places found, "
            f"{100 * found['recall_at_10']:.1f} % of the best 10; {found['bytes_per_place']:,} bytes a place, "
            f"built in {found['build_seconds']:.1f} s",
        )


def _notes_on_rates(run: Run, timing: Timing) -> Iterator[Note]:
    limit = "maximum" if run.timed_by.total_seconds is None else "total"
    unmet = f"a minimum of the timing protocol was not met within timing.{limit}_seconds"
    if not timing.streaming.valid:
        yield Note("invalid", f"invalid rates: {unmet}")
    elif not all(laps.valid for laps in timing.offline):
        yield Note("offline", f"invalid rates in batches: {unmet}")
    in_order = run.config["method"].get("adapt") == "running"  # the sample is asked in another order
    if not in_order and not _gives_same_answers(run, timing):
        yield Note("answers", "the timed run gave other answers than the scored run")


def _gives_same_answers(run: Run, timing: Timing) -> bool:
    """Return whether the places that the timed run named score best in the stored answers too."""
    queries = timing.sample[timing.answers >= 0]
    named = timing.answers[timing.answers >= 0]
    places, scores = run.top_places[queries], run.top_scores[queries]
    largest = np.abs(scores).max(1, initial=0, where=scores > -np.inf, keepdims=True)
    close = scores >= scores[:, :1] - _SAME_SCORE * largest
    return bool(((places == named[:, None]) & close).any(axis=1).all())
