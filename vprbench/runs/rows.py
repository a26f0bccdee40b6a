"""Stored runs as rows of text for people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from vprbench.metrics.accuracy import recall_at
from vprbench.metrics.catalogue import METRICS, RECALLS
from vprbench.runs.frame import format_label, recall_at_1_within
from vprbench.runs.recall_intervals import recall_interval
from vprbench.runs.record import Run
from vprbench.runs.stopwatch import StageRates, Timing, best_batch
from vprbench.runs.tuned import describe_recalls, without_tuning_places
from vprbench.text import NOTHING, format_interval, format_megabytes, format_rate, format_seconds

RECALL = "R@1 % [95 %]"
UNTIMED = "not timed"
VIEWS = ("sequence", "filter")  # their names in a protocol
LEAST = ("R@25 %", "R@10 %", "peak MB", "streaming Hz enc/match/total")  # left out first where a row is too wide
_DIGITS = 12  # of a hash that people compare by eye


def format_row(run: Run, metrics: Sequence[str] = ()) -> dict[str, str]:
    """Return one run as a row of text, with more `metrics` by their names; without a ground truth no accuracy."""
    shown = [METRICS[name] for name in (*(f"recall_at_{n}" for n in RECALLS[1:]), "auc_pr_a", *metrics)]
    if not run.is_judged:
        shown = [metric for metric in shown if metric.cost is not None]
    return {
        "method": format_label(run),
        **({RECALL: _format_recall(run)} if run.is_judged else {}),
        **{metric.head: metric.text(metric.of(run)) for metric in shown},
        "fit s": _format_fit(run),
        **_format_timing(run.timing),
        "peak MB": format_megabytes(run.peak_memory_bytes),
    }


def _format_timing(timing: Timing | None) -> dict[str, str]:
    streaming = offline = UNTIMED
    if timing is not None:
        batch = best_batch(timing.offline)
        streaming = _format_rates(StageRates.streaming(timing.streaming))
        offline = f"{_format_rates(StageRates.offline(batch))} (batch {batch.images_per_call})"
    return {"streaming Hz enc/match/total": streaming, "offline Hz enc/match/total": offline}


def _format_fit(run: Run) -> str:
    """Return the seconds of the fit, or a word for a run without one."""
    if run.fit_seconds is not None:
        return format_seconds(run.fit_seconds)
    return "kept" if run.network is None else "loaded"


def format_markdown(rows: Sequence[dict[str, str]]) -> str:
    """Return rows of text as a Markdown table; a missing value is a dash."""
    import pandas as pd  # takes long to import, and a run needs none

    rows = [{name: text.replace("|", r"\|") for name, text in row.items()} for row in rows]
    return str(pd.DataFrame(rows).fillna(NOTHING).to_markdown(index=False, disable_numparse=True))


def describe_protocol(run: Run) -> str:
    """Return one line: dataset, queries, places, protocol, and the first digits of the hash of the frames' names."""
    adapt = run.config["method"].get("adapt", "none")
    protocol = {**run.protocol, **({} if adapt == "none" else {"adapt": adapt})}
    chosen = ", ".join(f"{name} {format_value(value)}" for name, value in protocol.items())
    frames = f", data {run.data['names_sha256'][:_DIGITS]}" if run.data else ""
    return f"{run.dataset}: {len(run.outcome)} queries, {run.outcome.n_places} places ({chosen}){frames}"


def describe_view(run: Run, whole: bool = False) -> str:
    """Return the protocol of a view in a few words, or `whole`; empty for the run itself."""
    names = [name for name in run.protocol if name.startswith(VIEWS) and (whole or name in VIEWS)]
    return ", ".join(f"{name.replace('_', ' ')} {run.protocol[name]}" for name in names)


def describe_tolerance(run: Run) -> str | None:
    """Return in one line R@1 under the wider tolerances that the dataset asks for; None if it asks for none."""
    wider = recall_at_1_within(run)
    if not wider:
        return None
    shares = " / ".join(map(METRICS["recall_at_1"].text, wider.values()))
    return f"R@1 within {', '.join(map(str, wider))} places: {shares} %"


def _format_recall(run: Run) -> str:
    first, interval = recall_at(run.outcome, 1), recall_interval([run])
    if first is None or interval is None:
        return "undefined (no query has a right place)"
    ends = format_interval(interval.low, interval.high)
    others = f" elsewhere {describe_recalls([other])}" if (other := without_tuning_places(run)) else ""
    return f"{METRICS['recall_at_1'].text(first.expected)} {ends}{' ties!' if first.hangs_on_ties else ''}{others}"


def _format_rates(rates: StageRates) -> str:
    return " / ".join(map(format_rate, (rates.encode, rates.match, rates.total)))


def format_value(value: object) -> str:
    """Return one value of a protocol as text: "fall+spring", and of a mapping "5 in sun+2 in rain"."""
    if isinstance(value, Mapping):
        return "+".join(f"{inner} in {name}" for name, inner in value.items())
    return "+".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
