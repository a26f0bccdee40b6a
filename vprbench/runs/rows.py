"""Stored runs as rows of numbers for people: Markdown and CSV."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields

from vprbench.metrics.accuracy import recall_at
from vprbench.metrics.registry import METRICS, RECALLS
from vprbench.metrics.tolerance import hits_within
from vprbench.runs.rates import StageRates, best_batch, percentile_bound
from vprbench.runs.recall_intervals import recall_interval
from vprbench.runs.record import Failure, Run
from vprbench.runs.stopwatch import Timing
from vprbench.runs.tuned import describe_recalls, other_places, tuned_note

NOTHING, UNTIMED = "-", "not timed"
VIEWS = ("sequence", "filter")  # what a protocol calls them
LEAST = ("R@25 %", "R@10 %", "peak MB", "streaming Hz enc/match/total")  # left out first where a row is too wide
_DIGITS = 12  # of a hash that people compare by eye


def label(run: Run | Failure) -> str:
    """Return a method's name with the arguments that were asked for."""
    asked = [text.removeprefix("method.") for text in run.config.get("overrides", ()) if text.startswith("method.")]
    return " ".join([run.method, *asked])


def readable_row(run: Run, metrics: Sequence[str] = ()) -> dict[str, str]:
    """Return one run as a row of text, with more `metrics` by their names."""
    shown = [METRICS[name] for name in (*(f"recall_at_{n}" for n in RECALLS[1:]), "auc_pr_a", *metrics)]
    return {
        "method": label(run),
        "R@1 % [95 %]": _recall_with_interval(run),
        **{metric.head: metric.text(metric.of(run)) for metric in shown},
        "fit s": _fit(run),
        **_readable_rates(run.timing),
        "peak MB": f"{run.peak_memory_bytes / 1e6:.0f}",
    }


def _readable_rates(timing: Timing | None) -> dict[str, str]:
    streaming = offline = UNTIMED
    if timing is not None:
        batch = best_batch(timing.offline)
        streaming = _rates(StageRates.streaming(timing.streaming))
        offline = f"{_rates(StageRates.offline(batch))} (batch {batch.images_per_call})"
    return {"streaming Hz enc/match/total": streaming, "offline Hz enc/match/total": offline}


def _fit(run: Run) -> str:
    """Return the seconds of the fit, or what stood in for it."""
    if run.training_seconds is not None:
        return f"{run.training_seconds:.1f}" if run.training_seconds >= 10 else f"{run.training_seconds:.2g}"
    return "kept" if run.network is None else "loaded"


def markdown(rows: Sequence[dict[str, str]]) -> str:
    """Return rows of text as a Markdown table; what a row lacks is a dash."""
    import pandas as pd  # takes long to import, and a run needs none

    rows = [{name: text.replace("|", r"\|") for name, text in row.items()} for row in rows]
    return str(pd.DataFrame(rows).fillna(NOTHING).to_markdown(index=False, disable_numparse=True))


def numbers(run: Run, metrics: Sequence[str] = ()) -> dict[str, float | int | str | None]:
    """Return one run as unrounded numbers, under names that hold their unit, with more `metrics` by their names."""
    first, answerable = recall_at(run.outcome, 1), recall_at(run.outcome, 1, "answerable")
    interval = recall_interval([run])
    search = run.search or {}
    return {
        **_accuracies(run, [f"recall_at_{n}" for n in RECALLS]),
        "recall_at_1_low": interval.low if interval else None,
        "recall_at_1_high": interval.high if interval else None,
        "recall_at_1_interval": interval.kind if interval else None,
        "recall_at_1_block": interval.block if interval else None,
        "recall_at_1_answerable": answerable.expected if answerable else None,
        "recall_at_1_pessimistic": first.pessimistic if first else None,
        "recall_at_1_optimistic": first.optimistic if first else None,
        **{f"recall_at_1_within_{k}_places": share for k, share in recall_at_1_within(run).items()},
        **_elsewhere(run),
        **_accuracies(run, ["auc_pr_a", "average_precision_a"]),
        "fit_seconds": run.fit_seconds,
        "fit_compute_seconds": run.fit_compute_seconds,
        "first_query_seconds": None if run.timing is None else run.timing.first_query_seconds,
        "training_seconds": run.training_seconds,
        "training_compute_seconds": run.training_compute_seconds,
        "load_seconds": run.load_seconds,
        "fitted_alone": run.environment.get("fitted_alone"),
        "timed_alone": run.environment.get("timed_alone"),
        **_rate_numbers(run.timing),
        "index_recall_at_1": search.get("recall_at_1"),
        "index_recall_at_10": search.get("recall_at_10"),
        "index_bytes_per_place": search.get("bytes_per_place"),
        "index_build_seconds": search.get("build_seconds"),
        "peak_memory_bytes": run.peak_memory_bytes,
        "harness_seconds": run.harness_seconds,
        "method_seconds": run.method_seconds,
        "queries": len(run.outcome),
        "places": run.outcome.n_places,
        **_accuracies(run, metrics),
    }


def csv(results: Sequence[Run | Failure], metrics: Sequence[str] = ()) -> str:
    """Return runs as CSV, one line each, unrounded; a failed one has its error and no numbers."""
    import pandas as pd

    lines = []
    for result in results:
        line: dict[str, object] = {"method": label(result), "dataset": result.dataset}
        if isinstance(result, Failure):
            line |= {"error": result.error}
        else:
            frames = {name: result.data.get(name) for name in ("names_sha256", "content_sha256")}
            line |= {"protocol": result.protocol.get("protocol"), **frames}
            line |= {
                "error": "",
                **numbers(result, metrics),
                "network": result.network,
                "tuned_on": tuned_note([result]),
            }
        lines.append(line)
    return str(pd.DataFrame(lines, dtype=object).to_csv(index=False))


def protocol_line(run: Run) -> str:
    """Return in one line what was asked of which places, and by the first digits of a hash of which frames."""
    chosen = ", ".join(f"{name} {_plain(value)}" for name, value in run.protocol.items())
    frames = f", data {run.data['names_sha256'][:_DIGITS]}" if run.data else ""
    return f"{run.dataset}: {len(run.outcome)} queries, {run.outcome.n_places} places ({chosen}){frames}"


def describe_view(run: Run, whole: bool = False) -> str:
    """Return in a few words, or in all, what a view of a run shows; empty for the run itself."""
    names = [name for name in run.protocol if name.startswith(VIEWS) and (whole or name in VIEWS)]
    return ", ".join(f"{name.replace('_', ' ')} {run.protocol[name]}" for name in names)


def interval_line(run: Run) -> str | None:
    """Return in one line how long the blocks behind the interval of R@1 are; None for Wilson's interval."""
    interval = recall_interval([run])
    if interval is None or interval.kind == "independent":
        return None
    return f"interval of R@1: from blocks of {interval.block} neighbouring queries"


def tolerance_line(run: Run) -> str | None:
    """Return in one line R@1 under the wider tolerances that the dataset asks for; None if it asks for none."""
    wider = recall_at_1_within(run)
    if not wider:
        return None
    shares = " / ".join(map(METRICS["recall_at_1"].text, wider.values()))
    return f"R@1 within {', '.join(map(str, wider))} places: {shares} %"


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
    hits = hits_within(run.top_places, run.top_scores, run.positives, more, run.place_numbers)
    return {k: float(share) for k, share in zip(wider, hits.mean(axis=1), strict=True)}


def _elsewhere(run: Run) -> dict[str, float | int | None]:
    """Return R@1 of the queries that show no place the method was tuned on; None each if that is not known or all."""
    other = other_places(run)
    first, interval = (None, None) if other is None else (recall_at(other.outcome, 1), recall_interval([other]))
    return {
        "recall_at_1_elsewhere": first.expected if first else None,
        "recall_at_1_elsewhere_low": interval.low if interval else None,
        "recall_at_1_elsewhere_high": interval.high if interval else None,
        "queries_elsewhere": None if other is None else len(other.outcome),
    }


def _accuracies(run: Run, metrics: Sequence[str]) -> dict[str, float | None]:
    return {name: METRICS[name].of(run) for name in metrics}


def _recall_with_interval(run: Run) -> str:
    first, interval = recall_at(run.outcome, 1), recall_interval([run])
    if first is None or interval is None:
        return "undefined (no query has a right place)"
    ends = f"[{100 * interval.low:.1f}, {100 * interval.high:.1f}]"
    others = f" elsewhere {describe_recalls([other])}" if (other := other_places(run)) else ""
    return f"{METRICS['recall_at_1'].text(first.expected)} {ends}{' ties!' if first.hangs_on_ties else ''}{others}"


def _rates(rates: StageRates) -> str:
    return " / ".join(_hz(rate) for rate in (rates.encode, rates.match, rates.total))


def _hz(rate: float) -> str:
    return f"{rate:,.0f}" if rate >= 10 else f"{rate:.2g}"


def _rate_numbers(timing: Timing | None) -> dict[str, float | int | None]:
    """Return rates and percentiles by their names; without a timing each is None."""
    if timing is None:
        rates = (f"{scenario}_{stage.name}_hz" for scenario in ("streaming", "offline") for stage in fields(StageRates))
        return dict.fromkeys([*rates, "streaming_p90_seconds", "streaming_p99_seconds", "offline_batch"])
    streaming, batch = timing.streaming, best_batch(timing.offline)
    return {
        **_named_rates("streaming", StageRates.streaming(streaming)),
        "streaming_p90_seconds": percentile_bound(streaming.total_seconds, 0.9),
        "streaming_p99_seconds": percentile_bound(streaming.total_seconds, 0.99),
        **_named_rates("offline", StageRates.offline(batch)),
        "offline_batch": batch.images_per_call,
    }


def _named_rates(scenario: str, rates: StageRates) -> dict[str, float]:
    return {f"{scenario}_{stage}_hz": rate for stage, rate in asdict(rates).items()}


def _plain(value: object) -> str:
    if isinstance(value, Mapping):
        return "+".join(f"{inner} in {name}" for name, inner in value.items())
    return "+".join(map(str, value)) if isinstance(value, list) else str(value)
