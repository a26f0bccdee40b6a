"""Makes one run: fit, encode, match and the stopwatch; keeps answers and times, judges nothing."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from typing import Any

from vprbench import progress
from vprbench.api.adaptation import Adaptation
from vprbench.runs import spikes, timing_lock
from vprbench.runs.answers import QueryScoring, describe_search
from vprbench.runs.descriptors import DescriptorCache
from vprbench.runs.experiment import Experiment
from vprbench.runs.fitting import FitResult, fit_or_load
from vprbench.runs.identity import code_hash
from vprbench.runs.notes import make_notes, note_cache, note_measurements, note_scorer
from vprbench.runs.record import Run
from vprbench.runs.scorers import AdaptedScorer, choose_scorer
from vprbench.runs.stopwatch import Stopwatch, make_synchroniser
from vprbench.runs.watch import MachineWatch


@timing_lock.computing()
def execute(experiment: Experiment, key: str, keep: Callable[[Run], None] = lambda run: None) -> Run:
    """Fit a method or load its network, score every query and measure its rates.

    A network is stored before the first query; whether it can be is seen before it is trained. Timed queries are
    encoded, never taken from the experiment's cache of descriptors. Raises whatever the method raises.

    Args:
        experiment: method, dataset and request.
        key: identifies the run.
        keep: takes the run without its rates before these are measured, unless the request asks for none.
    """
    request, method, dataset = experiment.request, experiment.method, experiment.dataset
    queries, views = dataset.queries.unnamed(), experiment.views
    started = time.perf_counter()
    watch = MachineWatch(request.device, request.n_threads)
    stopwatch = Stopwatch(request.timing, synchronise=make_synchroniser(request.device), seed=request.seed)

    cache = experiment.cache if experiment.networks.load is None else None
    described = DescriptorCache.of(cache, method, experiment.config, dataset.n_places)
    fitted = fit_or_load(experiment, key, stopwatch, described)
    read = queries.reading.seconds
    scorer = choose_scorer(method, dataset.n_places, request.depth, request.scores, () if views is None else views.all)
    scoring = QueryScoring(stopwatch, method, scorer, dataset, request.depth, request.scores)

    def begin_traverse() -> Any:
        if method.adapt == "none":
            return scorer
        return AdaptedScorer(scorer, Adaptation(method) if scoring.adaptation.is_causal else scoring.adaptation)

    first_query = stopwatch.first_query(begin_traverse(), queries)
    watch.end_fit()
    scoring.method_seconds += first_query
    from_cache = scoring.score(described if views is None else None)
    elsewhere = fitted.seconds + scoring.method_seconds + queries.reading.seconds - read

    measured = {"data": experiment.data, **watch.record()}
    with stopwatch.lap() as auditing:
        counted, spike_notes = spikes.count_spikes(method, queries)
        measured |= {"search": describe_search(method, scoring.audited_codes), "spikes": counted}
    notes = (
        *make_notes("dataset", dataset.notes),
        *fitted.notes,
        *make_notes("method", method.notes()),
        *note_cache(dataset, fitted.from_cache, from_cache),
        *note_scorer(scorer, method, dataset.n_places),
    )
    harness_seconds = time.perf_counter() - started - elsewhere - auditing[0]
    scored = _make_record(experiment, key, fitted, scoring, {**measured, "harness_seconds": harness_seconds})
    scored = replace(scored, notes=(*notes, *note_measurements(scored), *spike_notes))
    if not request.timing.rates:
        return scored
    keep(scored)
    with watch.alone():
        timing = stopwatch.measure(begin_traverse(), queries, first_query)
        timed = replace(scored, timing=timing, **watch.record())
    progress.report("timing", 1.0)
    timed = replace(timed, config={**scored.config, "timing": asdict(request.timing)})
    return replace(timed, notes=(*notes, *note_measurements(timed), *spike_notes))


def _make_record(
    experiment: Experiment, key: str, fitted: FitResult, scoring: QueryScoring, measured: Mapping[str, Any]
) -> Run:
    """Return the record of a run that is not timed, but for its notes."""
    dataset = experiment.dataset
    return Run(
        method=experiment.request.method_name,
        dataset=dataset.name,
        key=key,
        config={**experiment.config, "code": code_hash(type(experiment.method)), "timing": None},
        protocol=dataset.protocol,
        fingerprint=experiment.fingerprint,
        notes=(),
        n_references=len(dataset.references),
        fit_seconds=fitted.fit_seconds,
        fit_compute_seconds=fitted.fit_compute_seconds,
        load_seconds=fitted.load_seconds,
        network=experiment.networks.sha256,
        method_seconds=fitted.method_seconds + scoring.method_seconds,
        timing=None,
        outcome=scoring.outcome,
        positives=dataset.positives,
        place_numbers=dataset.place_numbers,
        query_breaks=dataset.query_breaks,
        place_breaks=dataset.place_breaks,
        tuned_on=experiment.request.tuned_on,
        tuned_queries=experiment.tuned_queries,
        top_places=scoring.top_places,
        top_scores=scoring.top_scores,
        scores=scoring.scores,
        **measured,
    )
