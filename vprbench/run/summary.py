"""The numbers of one run that people ask for first, computed from its record."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from vprbench.metrics.accuracy import recall_at
from vprbench.metrics.intervals import WiderInterval
from vprbench.metrics.tolerance import hits_within
from vprbench.run.rates import best_batch, offline_rate, streaming_rate
from vprbench.run.recall_intervals import recall_interval
from vprbench.run.record import Run


@dataclass(frozen=True)
class StageRates:
    """Images per second of each stage, and of both together."""

    encode: float
    match: float
    total: float


@dataclass(frozen=True)
class Summary:
    """What is known of R@1 of one run beside its value, and its speed; `METRICS` holds the accuracies."""

    recall_at_1_interval: WiderInterval | None  # 95 %; None, here and below, where no query has a right place
    recall_at_1_answerable: float | None  # of the queries that have a right place
    recall_at_1_pessimistic: float | None  # ties broken against the method
    recall_at_1_optimistic: float | None
    recall_at_1_within: Mapping[int, float | None]  # so many places, as the dataset asks for
    hangs_on_ties: bool  # these two differ by more than half a point
    streaming: StageRates
    streaming_p90_seconds: float | None  # of the total, upper 99 % bound
    streaming_p99_seconds: float | None
    offline: StageRates
    offline_batch: int  # images per call in the fastest batch size
    peak_memory_bytes: int


def summarise(run: Run) -> Summary:
    """Compute a run's summary."""
    first = recall_at(run.outcome, 1)
    answerable = recall_at(run.outcome, 1, "answerable")
    streaming = run.timing.streaming
    batch = best_batch(run.timing.offline)
    total = streaming_rate(streaming.total_seconds)
    return Summary(
        recall_at_1_interval=recall_interval([run]),
        recall_at_1_answerable=answerable.expected if answerable else None,
        recall_at_1_pessimistic=first.pessimistic if first else None,
        recall_at_1_optimistic=first.optimistic if first else None,
        recall_at_1_within=recall_at_1_within(run),
        hangs_on_ties=first.hangs_on_ties if first else False,
        streaming=StageRates(
            streaming_rate(streaming.encode_seconds).hz, streaming_rate(streaming.match_seconds).hz, total.hz
        ),
        streaming_p90_seconds=total.p90_seconds,
        streaming_p99_seconds=total.p99_seconds,
        offline=StageRates(
            offline_rate(batch.encode_seconds, batch.images_per_call),
            offline_rate(batch.match_seconds, batch.images_per_call),
            offline_rate(batch.total_seconds, batch.images_per_call),
        ),
        offline_batch=batch.images_per_call,
        peak_memory_bytes=run.peak_memory_bytes,
    )


def recall_at_1_within(run: Run) -> dict[int, float | None]:
    """Return R@1 within the places that a protocol names in `also_tolerance_places`, where it is not that wide itself.

    They count from the right place along the whole journey, as `tolerance_places` does. None are given where that is
    not 0 and the map lacks places: which place is in the middle is not stored.
    """
    own = int(run.protocol.get("tolerance_places", 0))
    wider = [int(k) for k in run.protocol.get("also_tolerance_places", ()) if k > own]
    if not wider or (own and run.place_numbers is not None):
        return {}
    if not run.outcome.answerable.any():
        return dict.fromkeys(wider)
    more = [k - own for k in wider]
    hits = hits_within(run.top_places, run.top_scores, run.positives, more, run.place_numbers)
    return {k: float(share) for k, share in zip(wider, hits.mean(axis=1), strict=True)}
