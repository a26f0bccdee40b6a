"""Made-up runs with known answers, as many methods, seeds, sizes and machines as a figure wants."""

import hashlib
from dataclasses import replace
from statistics import NormalDist
from typing import Any

import little
import numpy as np

from vprbench.report.selection import MethodRuns
from vprbench.runs.stopwatch import Laps


def seconds_around(median, spread, n_laps=101, seed=0):
    """Return times in random order whose median is `median` and whose logarithms are normal with `spread`."""
    quantiles = [NormalDist().inv_cdf((i + 0.5) / n_laps) for i in range(n_laps)]
    return np.random.default_rng(seed).permutation(median * np.exp(spread * np.array(quantiles)))


def timing(encode_seconds, match_seconds, spread=0.1):
    """Return streaming laps with these medians; encode and match vary together, so that the total's is their sum."""
    encode, match = (seconds_around(median, spread) for median in (encode_seconds, match_seconds))
    laps = Laps(encode, match, 1, True)
    return replace(little.a_run().timing, streaming=laps, offline=(laps,))


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


def run(method="little", share=0.5, n_queries=40, n_places=50, **changes):
    """Return a run whose R@1 is `share`; `changes` are fields of the run, or what is taken from them below."""
    take = changes.pop
    if "fit_seconds" in changes:
        changes.setdefault("fit_compute_seconds", changes["fit_seconds"])
    seed, device = take("seed", 0), take("device", "cpu")
    dataset = changes.get("dataset", "railway")
    scores = scores_with_recall(share, n_queries, n_places, seed)
    positives = [[query % n_places] for query in range(n_queries)]
    stored_bytes = take("bytes_per_place", None)
    made: dict[str, Any] = {
        "method": method,
        "dataset": dataset,
        "key": hashlib.sha256(f"{method}{dataset}{n_places}{seed}{device}".encode()).hexdigest()[:16],
        "config": {
            "method": {"_target_": f"vprbench.methods.{method}", **(arguments := take("arguments", {}))},
            "changed": dict(arguments),
            "dataset": {"name": dataset, **take("dataset_arguments", {})},
            **{"seed": seed, "device": device, "depth": 25, "code": take("code", "c0de")},
            "overrides": [f"method={method}", f"dataset={dataset}", *(f"method.{n}={v}" for n, v in arguments.items())],
            "timing": {"minimum_seconds": 2.0},
        },
        "fingerprint": hashlib.sha256(f"{dataset}{n_places}".encode()).hexdigest(),
        "environment": {
            **little.a_run().environment,
            **{"processor": take("processor", "Abacus 9"), "time_utc": take("time_utc", "2025-01-31T12:00:00Z")},
            **({"accelerator": "Loom 7"} if device.startswith("cuda") else {}),
            "device": device,
        },
        "n_references": n_places,
        "search": None if stored_bytes is None else {"index": "exact", "bytes_per_place": stored_bytes},
        "timing": timing(take("encode_seconds", 0.001), take("match_seconds", 0.001), take("spread", 0.1)),
    }
    return little.answered(scores, positives, 25, **{**made, **changes})


def series(name, *runs):
    return MethodRuns(name, runs)


def sized(n_places, fit_seconds, match_seconds, **changes):
    """Return a run of four queries on a map of any size, quick to make: its answers mean nothing."""
    small = run("vprtempo", n_queries=4, n_places=50, match_seconds=match_seconds, fit_seconds=fit_seconds, **changes)
    return replace(small, outcome=replace(small.outcome, n_places=n_places), n_references=2 * n_places, scores=None)
