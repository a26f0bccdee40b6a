"""Made-up runs with known answers, as many methods, seeds, sizes and machines as a figure wants."""

from dataclasses import replace
from statistics import NormalDist

import little
import numpy as np
import stored_runs

from vprbench.report.selection import MethodRuns


def seconds_around(median, spread, n_laps=101, seed=0):
    """Return times in random order whose median is `median` and whose logarithms are normal with `spread`."""
    quantiles = [NormalDist().inv_cdf((i + 0.5) / n_laps) for i in range(n_laps)]
    return np.random.default_rng(seed).permutation(median * np.exp(spread * np.array(quantiles)))


def scores_with_recall(share, n_queries, n_places, seed=0):
    """Return scores (n_queries, n_places) whose right place, the query's own number, is best for `share` of them."""
    random = np.random.default_rng(seed)
    scores = random.uniform(0, 0.4, (n_queries, n_places)).astype(np.float32)
    hits = np.zeros(n_queries, bool)
    hits[random.permutation(n_queries)[: round(share * n_queries)]] = True
    queries = np.arange(n_queries)
    right = queries % n_places
    wrong = (right + random.integers(n_places // 3, n_places // 2, n_queries)) % n_places
    scores[queries, right] = random.uniform(0.3, 0.6, n_queries)
    best = np.where(hits, random.uniform(0.7, 1, n_queries), random.uniform(0.65, 0.85, n_queries))
    scores[queries, np.where(hits, right, wrong)] = best
    return scores


def run(method="little", share=0.5, n_queries=40, n_places=50, seed=0, spread=0.1, dataset="railway", **changes):
    """Return a run whose R@1 is `share`; encode and match vary together, so that the total's median is their sum."""
    take = changes.pop
    if "fit_seconds" in changes:
        changes.setdefault("fit_compute_seconds", changes["fit_seconds"])
    positives = [[query % n_places] for query in range(n_queries)]
    given = little.answered(scores_with_recall(share, n_queries, n_places, seed), positives, 25)
    made = {name: getattr(given, name) for name in ("outcome", "positives", "top_places", "top_scores", "scores")}
    for step in ("encode_seconds", "match_seconds"):
        made[step] = seconds_around(take(step, 0.001), spread)
    kept = take("bytes_per_place", None)
    return stored_runs.run(
        method,
        seed,
        dataset={"name": dataset, **take("dataset_arguments", {})},
        changed=take("arguments", {}),
        config={"depth": 25},
        **{"key": f"{method}-{dataset}-{n_places}-{seed}", "fingerprint": f"{dataset} {n_places}"},
        **{"search": kept and {"index": "exact", "bytes_per_place": kept}, "n_references": n_places},
        **{**made, **changes},
    )


def series(name, *runs):
    return MethodRuns(name, runs)


def sized(n_places, fit_seconds, match_seconds, **changes):
    """Return a run of four queries on a map of any size, quick to make: its answers mean nothing."""
    small = run("vprtempo", n_queries=4, n_places=50, match_seconds=match_seconds, fit_seconds=fit_seconds, **changes)
    return replace(small, outcome=replace(small.outcome, n_places=n_places), n_references=2 * n_places, scores=None)
