"""Makes one run: fit, encode, match and the stopwatch; keeps answers and times, judges nothing."""

from __future__ import annotations

import time
from dataclasses import asdict, replace

from vprbench import progress
from vprbench.runs import spikes
from vprbench.runs.answers import QueryScoring, describe_search
from vprbench.runs.descriptors import DescriptorCache
from vprbench.runs.experiment import Experiment
from vprbench.runs.fitting import fit_or_load
from vprbench.runs.identity import hash_code
from vprbench.runs.notes import make_notes, note_measurements, note_scorer
from vprbench.runs.record import Run
from vprbench.runs.scorers import choose_scorer
from vprbench.runs.stopwatch import Stopwatch, make_synchroniser
from vprbench.runs.timing_lock import TimingLock
from vprbench.runs.watch import MachineWatch


def execute(experiment: Experiment, key: str, lock: TimingLock) -> Run:
    """Fit a method or load its network, score every query and measure its rates.

    A network is stored before the first query; whether it can be is seen before it is trained. Timed queries are
    encoded, never taken from the experiment's cache of descriptors. Raises whatever the method raises.

    Args:
        experiment: method, dataset and request.
        key: identifies the run.
        lock: by which this process computes.
    """
    request, method, dataset = experiment.request, experiment.method, experiment.dataset
    queries, views = dataset.queries.unnamed(), () if experiment.views is None else experiment.views.all
    started = time.perf_counter()
    watch = MachineWatch(request.device, request.n_threads, lock)
    stopwatch = Stopwatch(request.timing, synchronise=make_synchroniser(request.device), seed=request.seed)

    cache = experiment.cache if experiment.networks.load is None else None
    described = DescriptorCache.of(cache, method, experiment.config)
    fitted = fit_or_load(experiment, key, stopwatch, described)
    read = queries.reading.seconds
    scorer = choose_scorer(method, dataset.n_places, request.depth, request.scores, views)
    first_query_seconds = stopwatch.first_query(scorer.begin_traverse(), queries)
    watch.end_fit()
    scoring = QueryScoring(stopwatch, scorer, dataset, request.depth, request.scores)
    scoring.score(None if views else described)
    query_seconds = first_query_seconds + scoring.method_seconds
    elsewhere = fitted.seconds + query_seconds + queries.reading.seconds - read
    watched = watch.record()
    with stopwatch.lap() as auditing:
        search = describe_search(method, queries)
        counted, spike_notes = spikes.count_spikes(method, queries)
    run = Run(
        method=request.method_name,
        dataset=dataset.name,
        key=key,
        config={**experiment.config, "code": hash_code(type(method)), "timing": None},
        protocol=dataset.protocol,
        fingerprint=experiment.fingerprint,
        notes=(
            *make_notes("dataset", dataset.notes),
            *fitted.notes,
            *make_notes("method", method.notes()),
            *note_scorer(scorer, dataset.n_places),
            *spike_notes,
        ),
        n_references=len(dataset.references),
        fit_seconds=fitted.fit_seconds,
        fit_compute_seconds=fitted.fit_compute_seconds,
        load_seconds=fitted.load_seconds,
        network=experiment.networks.sha256,
        search=search,
        method_seconds=fitted.method_seconds + query_seconds,
        harness_seconds=time.perf_counter() - started - elsewhere - auditing[0],
        timing=None,
        outcome=scoring.outcome,
        positives=dataset.positives,
        place_numbers=dataset.place_numbers,
        query_breaks=dataset.query_breaks,
        place_breaks=dataset.place_breaks,
        tuned_on=request.tuned_on,
        tuned_queries=experiment.tuned_queries,
        top_places=scoring.top_places,
        top_scores=scoring.top_scores,
        scores=scoring.scores,
        spikes=counted,
        data=experiment.data,
        **watched,
    )
    if request.timing.rates:
        with watch.alone():
            timing = stopwatch.measure(scorer.begin_traverse(), queries, first_query_seconds)
            run = replace(run, timing=timing, **watch.record())
        progress.report("timing", 1.0)
        run = replace(run, config={**run.config, "timing": asdict(request.timing)})
    return replace(run, notes=(*run.notes, *note_measurements(run)))
