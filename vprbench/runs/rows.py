"""Stored runs as rows of text for people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from vprbench.metrics.accuracy import compute_recall
from vprbench.metrics.catalogue import METRICS, RECALLS
from vprbench.runs.frame import Numbers, format_label, list_numbers, recall_at_1_within
from vprbench.runs.record import Run
from vprbench.text import NOTHING, format_megabytes, format_rate, format_seconds

RECALL = "R@1 % [95 %]"
UNTIMED = "not timed"
LEAST = ("R@25 %", "R@10 %", "peak MB", "streaming Hz enc/match/total")  # left out first where a row is too wide
_DIGITS = 12  # of a hash that people compare by eye


def format_row(run: Run, metrics: Sequence[str] = ()) -> dict[str, str]:
    """Return one run as a row of text, with more `metrics` by their names; without a ground truth no accuracy."""
    numbers = list_numbers(run, metrics)
    shown = [METRICS[name] for name in (*(f"recall_at_{n}" for n in RECALLS[1:]), "auc_pr_a", *metrics)]
    fit = numbers["fit_seconds"]
    unfitted = "kept" if run.network is None else "loaded"
    batch = "" if run.timing is None else f" (batch {numbers['offline_batch']})"
    return {
        "method": format_label(run),
        **({RECALL: _format_recall(run, numbers)} if run.is_judged else {}),
        **{metric.head: metric.text(numbers[metric.name]) for metric in shown if run.is_judged or metric.cost},
        "fit s": unfitted if fit is None else format_seconds(fit),
        "streaming Hz enc/match/total": _format_rates(numbers, "streaming"),
        "offline Hz enc/match/total": _format_rates(numbers, "offline") + batch,
        "peak MB": format_megabytes(run.peak_memory_bytes),
    }


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


def describe_sequence(run: Run) -> str:
    """Return the protocol of a view in a few words; empty for the run itself."""
    return ", ".join(f"{name} {run.protocol[name]}" for name in ("sequence", "filter") if name in run.protocol)


def describe_wider_recall(run: Run) -> str | None:
    """Return in one line R@1 under the wider tolerances that the dataset asks for; None if it asks for none."""
    wider = recall_at_1_within(run)
    if not wider:
        return None
    shares = " / ".join(map(METRICS["recall_at_1"].text, wider.values()))
    return f"R@1 within {', '.join(map(str, wider))} places: {shares} %"


def _format_recall(run: Run, numbers: Numbers) -> str:
    recall = compute_recall(run.outcome, 1)
    if recall is None:
        return "undefined (no query has a right place)"
    ties = " ties!" if recall.hangs_on_ties else ""
    elsewhere = f" elsewhere {_format_interval(numbers, '_elsewhere')}" if numbers["queries_elsewhere"] else ""
    return f"{_format_interval(numbers)}{ties}{elsewhere}"


def _format_interval(numbers: Numbers, ending: str = "") -> str:
    percent = METRICS["recall_at_1"].text
    share, low, high = (percent(numbers[f"recall_at_1{ending}{end}"]) for end in ("", "_low", "_high"))
    return f"{share} [{low}, {high}]"


def _format_rates(numbers: Numbers, way: str) -> str:
    rates = [numbers[f"{way}_{stage}_hz"] for stage in ("encode", "match", "total")]
    return UNTIMED if None in rates else " / ".join(map(format_rate, rates))


def format_value(value: object) -> str:
    """Return one value of a protocol as text: "fall+spring", and of a mapping "5 in sun+2 in rain"."""
    if isinstance(value, Mapping):
        return "+".join(f"{inner} in {name}" for name, inner in value.items())
    return "+".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
