"""Stored runs as one table of numbers: a row a run, a column a fact; docs/numbers.md explains the columns."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, Literal

from vprbench.metrics.accuracy import compute_recall, count_hits_within
from vprbench.metrics.catalogue import METRICS, RECALLS
from vprbench.runs.machine import Machine
from vprbench.runs.notes import DISTURBED
from vprbench.runs.recall_intervals import estimate_recall_interval
from vprbench.runs.record import Failure, Run
from vprbench.runs.stopwatch import (
    Timing,
    compute_offline_rate,
    compute_streaming_rate,
    estimate_percentile_bound,
    find_fastest_batch,
)
from vprbench.runs.tuned import describe_tuning, without_tuning_places

if TYPE_CHECKING:
    import pandas as pd

Numbers = dict[str, Any]  # float, int, str, or None if it is not known

_AREAS = ("auc_pr_a", "average_precision_a")
_TIMED = (
    *("streaming_encode_hz", "streaming_match_hz", "streaming_total_hz"),
    *("streaming_p90_seconds", "streaming_p99_seconds"),
    *("offline_encode_hz", "offline_match_hz", "offline_total_hz", "offline_batch"),
)
_OF_INDEX = ("recall_at_1", "recall_at_10", "bytes_per_place", "build_seconds")

#: The columns of every frame, in their order; `recall_at_1_within_K_places` and more metrics come on request.
COLUMNS = (
    *("method", "arguments", "label", "dataset", "dataset_arguments", "protocol", "protocol_name"),
    *("names_sha256", "content_sha256", "fingerprint", "seed", "device", "error"),
    *(f"recall_at_{n}" for n in RECALLS),
    *("recall_at_1_low", "recall_at_1_high", "recall_at_1_interval", "recall_at_1_block", "recall_at_1_answerable"),
    *("recall_at_1_pessimistic", "recall_at_1_optimistic", "recall_at_1_elsewhere", "recall_at_1_elsewhere_low"),
    *("recall_at_1_elsewhere_high", "queries_elsewhere", *_AREAS),
    *("fit_seconds", "fit_compute_seconds", "first_query_seconds", "training_seconds", "training_compute_seconds"),
    *("load_seconds", "fitted_alone", "timed_alone", *_TIMED, *(f"index_{name}" for name in _OF_INDEX)),
    *("peak_memory_bytes", "harness_seconds", "method_seconds", "queries", "places", "network", "tuned_on"),
    *("machine", "time_utc", "disturbed", "notes", "key"),
)

#: Columns of the frame under other names in CSV files, where `method` is the name with its arguments.
_IN_CSV = {"label": "method", "protocol_name": "protocol"}
_DIGITS = 12  # of a fingerprint that people compare by eye


def tabulate_runs(results: Iterable[Run | Failure], metrics: Sequence[str] = ()) -> pd.DataFrame:
    """Return runs and failures as rows, with more `metrics` by their names; unknown values are None.

    A failure has its `error` and no numbers.
    """
    import pandas as pd  # takes long to import, and a run needs none

    rows = [_list_facts(each, metrics) for each in results]
    columns = dict.fromkeys(name for names in (COLUMNS, *rows, metrics) for name in names)
    return pd.DataFrame(rows, columns=[*columns], dtype=object)


def tabulate_with_records(runs: Sequence[Run], metrics: Sequence[str] = ()) -> pd.DataFrame:
    """Return the frame of runs with the runs themselves in one more column, `record`."""
    import pandas as pd

    return tabulate_runs(runs, metrics).assign(record=pd.Series(list(runs), dtype=object))


def format_csv(results: Sequence[Run | Failure], metrics: Sequence[str] = ()) -> str:
    """Return the frame of runs as CSV, a line each, unrounded."""
    table = tabulate_runs(results, metrics).drop(columns=["method", "arguments", "protocol"])
    return str(table.rename(columns=_IN_CSV).to_csv(index=False))


def iterate_rows(table: pd.DataFrame) -> Iterator[Any]:
    """Yield the lines of a frame as named tuples."""
    return iter(table.itertuples(index=False))


def format_label(run: Run | Failure) -> str:
    """Return a method's name with the arguments of its command line."""
    return f"{run.method} {_format_arguments(run, 'method')}".rstrip()


def _list_facts(result: Run | Failure, metrics: Sequence[str]) -> dict[str, Any]:
    facts = {
        "method": result.method,
        "arguments": _format_arguments(result, "method"),
        "label": format_label(result),
        "dataset": result.dataset,
        **{name: result.config.get(name) for name in ("seed", "device")},
        "error": "",
    }
    if isinstance(result, Failure):
        return {**facts, "error": result.error}
    return {
        **facts,
        "dataset_arguments": _format_arguments(result, "dataset"),
        "protocol": " ".join(f"{name}={value}" for name, value in result.protocol.items()),
        "protocol_name": result.protocol.get("protocol"),
        **{name: result.data.get(name) for name in ("names_sha256", "content_sha256")},
        "fingerprint": result.fingerprint[:_DIGITS],
        **list_numbers(result, metrics),
        "network": result.network,
        "tuned_on": describe_tuning([result]),
        "machine": Machine.of(result.environment).line,
        "time_utc": str(result.environment.get("time_utc") or ""),
        "disturbed": any(note.kind in DISTURBED for note in result.notes),
        "notes": "; ".join(note.text for note in result.notes),
        "key": result.key,
    }


def list_numbers(run: Run, metrics: Sequence[str] = ()) -> Numbers:
    """Return one run as unrounded numbers, under names that hold their unit, with more `metrics` by their names."""
    first, answerable = compute_recall(run.outcome, 1), compute_recall(run.outcome, 1, "answerable")
    interval, others = estimate_recall_interval([run]), without_tuning_places(run)
    elsewhere = None if others is None else compute_recall(others.outcome, 1)
    interval_elsewhere = None if others is None else estimate_recall_interval([others])
    return {
        **_compute_metrics(run, [f"recall_at_{n}" for n in RECALLS]),
        "recall_at_1_low": interval.low if interval else None,
        "recall_at_1_high": interval.high if interval else None,
        "recall_at_1_interval": interval.kind if interval else None,
        "recall_at_1_block": interval.block if interval else None,
        "recall_at_1_answerable": answerable.expected if answerable else None,
        "recall_at_1_pessimistic": first.pessimistic if first else None,
        "recall_at_1_optimistic": first.optimistic if first else None,
        **{f"recall_at_1_within_{k}_places": share for k, share in recall_at_1_within(run).items()},
        "recall_at_1_elsewhere": elsewhere.expected if elsewhere else None,
        "recall_at_1_elsewhere_low": interval_elsewhere.low if interval_elsewhere else None,
        "recall_at_1_elsewhere_high": interval_elsewhere.high if interval_elsewhere else None,
        "queries_elsewhere": None if others is None else len(others.outcome),
        **_compute_metrics(run, _AREAS),
        "fit_seconds": run.fit_seconds,
        "fit_compute_seconds": run.fit_compute_seconds,
        "first_query_seconds": None if run.timing is None else run.timing.first_query_seconds,
        "training_seconds": run.fit_seconds,
        "training_compute_seconds": run.fit_compute_seconds,
        "load_seconds": run.load_seconds,
        **{name: run.environment.get(name) for name in ("fitted_alone", "timed_alone")},
        **_list_rates(run.timing),
        **{f"index_{name}": (run.search or {}).get(name) for name in _OF_INDEX},
        **{name: getattr(run, name) for name in ("peak_memory_bytes", "harness_seconds", "method_seconds")},
        "queries": len(run.outcome),
        "places": run.outcome.n_places,
        **_compute_metrics(run, metrics),
    }


def recall_at_1_within(run: Run) -> dict[int, float | None]:
    """Return R@1 within the places that a protocol names in `also_tolerance_places`, if it is not that wide itself.

    They count from the right place along the whole journey, as `tolerance_places` does. Empty if the dataset has a
    tolerance of its own and its map has gaps: the centre of each match is not stored.
    """
    own = int(run.protocol.get("tolerance_places", 0))
    wider = [int(k) for k in run.protocol.get("also_tolerance_places", ()) if k > own]
    if not wider or (own and run.place_numbers is not None):
        return {}
    if not run.outcome.answerable.any():
        return dict.fromkeys(wider)
    more = [k - own for k in wider]
    hits = count_hits_within(run.top_places, run.top_scores, run.positives, more, run.place_numbers)
    return {k: float(share) for k, share in zip(wider, hits.mean(axis=1), strict=True)}


def _format_arguments(run: Run | Failure, of: Literal["method", "dataset"]) -> str:
    """Return the arguments of the method or the dataset on the command line, as name=value."""
    given = (option.lstrip("+") for option in run.config.get("overrides", ()))
    return " ".join(option.removeprefix(f"{of}.") for option in given if option.startswith(f"{of}."))


def _compute_metrics(run: Run, metrics: Sequence[str]) -> dict[str, float | None]:
    return {name: METRICS[name].of(run) for name in metrics}


def _list_rates(timing: Timing | None) -> dict[str, float | int | None]:
    """Return rates and percentiles by their names; without a timing each is None."""
    if timing is None:
        return dict.fromkeys(_TIMED)
    single, batch = timing.streaming, find_fastest_batch(timing.offline)
    rates = (
        *(compute_streaming_rate(seconds) for seconds in single.by_stage),
        *(estimate_percentile_bound(single.total_seconds, share) for share in (0.9, 0.99)),
        *(compute_offline_rate(seconds, batch.images_per_call) for seconds in batch.by_stage),
        batch.images_per_call,
    )
    return dict(zip(_TIMED, rates, strict=True))
