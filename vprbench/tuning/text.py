"""The report of a search: Markdown, and every trial as CSV."""

from __future__ import annotations

import shlex
from pathlib import Path

import pandas as pd
from optuna.trial import FrozenTrial

from vprbench.runs.machine import format_software
from vprbench.runs.rows import format_markdown
from vprbench.storage.atomic import replace_text
from vprbench.text import format_percent, format_signed_percent
from vprbench.tuning.search import AGREE, SEEDS, Comparison, Found, Verdict
from vprbench.tuning.settings import Settings
from vprbench.tuning.space import METHOD, PARAMETERS, TITLE

_PLACES = {"searched": "searched (they chose)", "checked": "held out (they chose nothing)"}
_VERDICTS: dict[Verdict, str] = {
    "better": "the best settings are better",
    "worse": "the paper's settings are better",
    "not told apart": "best and paper cannot be told apart",
}


def write_report(found: Found, folder: Path) -> str:
    """Write the report and every trial into a folder and into the folder of the study; returns the text to print.

    In the folder the names hold an unusual dataset and a quick search: search.md and search.csv, search-nordland.md,
    search-quick.md.
    """
    text, trials = format_report(found), format_trials(found)
    unusual = [found.settings.dataset] * (found.settings.dataset != Settings.dataset)
    stem = "-".join(["search", *unusual, *["quick"] * found.settings.quick])
    for place, name in ((found.folder, "search"), (folder, stem)):
        replace_text(place / f"{name}.csv", trials)
        replace_text(place / f"{name}.md", text)
    return f"{text}\nwritten to {folder / stem}.md and {folder / stem}.csv, and into {found.folder}\n"


def format_report(found: Found) -> str:
    """Return best settings, importance, comparison with the paper and origin as Markdown."""
    states = [_describe_state(trial) for trial in found.trials]
    n_random = sum(trial.user_attrs["stage"] == "random" for trial in found.trials)
    recall = max(trial.value or 0.0 for trial in found.trials)
    first, held = (protocol["stretch"] for protocol in found.protocols.values())
    here = found.environment
    parts = [
        "# Hyperparameter search",
        f"{len(states)} trials of {TITLE} on {found.settings.dataset}: {n_random} random, {len(states) - n_random} on "
        f"a grid around the best of these. Diverged, which counts as R@1 0: {states.count('diverged')}. Failed: "
        f"{states.count('failed')}. A trial trains one network with seed {found.settings.seed} on the searched places "
        "and scores all queries there. No column of the table queries these places.",
        "## Best settings",
        format_markdown(_tabulate_parameters(found)),
        f"R@1 {format_percent(recall)} %, the highest of all trials on the queries that chose it: luck raises it, the "
        "comparison below does not use it. Importance is a parameter's share in how R@1 varies over the random trials "
        f"(fANOVA).{' R@1 did not vary.' * (not found.importance)}",
        "## Best against paper",
        format_markdown([_summarise_comparison(name, compared) for name, compared in found.compared.items()]),
        f"Held out: {_VERDICTS[found.compared['checked'].verdict]}. Both are trained with the same {SEEDS} seeds, none "
        "of which chose the best; R@1 is mean ± standard deviation over them, the interval that of the difference of "
        f"the per-query means. Better needs an interval without 0 and {AGREE} of {SEEDS} seeds.",
        "## Run the best settings",
        f"```\n{format_command(found)}\n```",
        "## Origin",
        f"Places {first[0]} to {first[1]} were searched, {held[0]} to {held[1]} held out. This call tried "
        f"{found.tried_now} settings in {found.minutes:.1f} minutes. All trials lie in {found.folder}; the same "
        "command goes on there.",
        f"{here['processor']}, {found.jobs} processes of one thread on {here['cores']} cores, "
        f"{here['memory_bytes'] / 1e9:.0f} GB, {here['platform']}. {format_software(here)}",
    ]
    return "\n\n".join(parts) + "\n"


def format_command(found: Found) -> str:
    """Return the command that runs the best settings on the whole dataset."""
    options = [f"method={METHOD}", f"dataset={found.settings.dataset}"]
    if found.settings.root is not None:
        options.append(f"dataset.root={found.settings.root}")
    options += [f"method.{name}={value:g}" for name, value in found.best.items()]
    return " ".join(["python -m vprbench", *map(shlex.quote, options)])


def format_trials(found: Found) -> str:
    """Return every trial as a line of CSV, failed ones without R@1."""
    return pd.DataFrame(
        {
            "trial": trial.number,
            "stage": trial.user_attrs["stage"],
            "state": _describe_state(trial),
            "recall_at_1": trial.value,
            **{parameter.name: trial.params.get(parameter.name) for parameter in PARAMETERS},
            "seconds": trial.duration and trial.duration.total_seconds(),
            "reason": trial.user_attrs.get("diverged") or trial.user_attrs.get("failed"),
        }
        for trial in found.trials
    ).to_csv(index=False)


def _describe_state(trial: FrozenTrial) -> str:
    return "failed" if trial.value is None else "diverged" if trial.user_attrs["diverged"] else "done"


def _tabulate_parameters(found: Found) -> list[dict[str, str]]:
    return [
        {
            "parameter": parameter.symbol,
            "argument": f"method.{parameter.name}",
            "best": f"{found.best[parameter.name]:g}",
            "paper": f"{parameter.paper:g}",
            "searched": f"{parameter.low:g} to {parameter.high:g}{' (log)' * parameter.log}",
            "importance %": format_percent(found.importance.get(parameter.name)),
        }
        for parameter in PARAMETERS
    ]


def _summarise_comparison(name: str, compared: Comparison) -> dict[str, str]:
    ends = compared.interval
    interval = "-" if ends is None else f"{format_signed_percent(ends.low)}, {format_signed_percent(ends.high)}"
    recalls = {"best": compared.best.mean(axis=1), "paper": compared.paper.mean(axis=1)}
    return {
        "places": _PLACES[name],
        "number": str(compared.n_places),
        "queries": str(compared.best.shape[1]),
        **{
            f"{side} R@1 %": f"{format_percent(values.mean())} ± {format_percent(values.std(ddof=1))}"
            for side, values in recalls.items()
        },
        "difference [95 %]": f"{format_signed_percent(float(compared.differences.mean()))} [{interval}]",
        "seeds with best ahead": f"{sum(compared.differences > 0)} of {SEEDS}",
    }
