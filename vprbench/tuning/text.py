"""The report of a search: Markdown, and every trial as CSV."""

from __future__ import annotations

import shlex
from pathlib import Path

import pandas as pd
from optuna.trial import FrozenTrial

from vprbench.metrics.intervals import difference_interval
from vprbench.runs.machine import describe_machine, format_versions
from vprbench.runs.rows import format_markdown
from vprbench.storage.atomic import replace_text
from vprbench.text import format_percent, format_signed_percent
from vprbench.tuning.search import SEEDS, Found
from vprbench.tuning.settings import Settings
from vprbench.tuning.space import METHOD, PARAMETERS, TITLE


def write_report(found: Found, folder: Path) -> str:
    """Write the report and every trial into a folder; returns the text to print.

    The names hold an unusual dataset: search.md and search.csv, search-nordland.md and search-nordland.csv.
    """
    name = found.settings.dataset
    file = folder / ("search" if name == Settings.dataset else f"search-{name}")
    text = format_report(found)
    replace_text(file.with_suffix(".csv"), format_trials(found))
    replace_text(file.with_suffix(".md"), text)
    return f"{text}\nwritten to {file}.md and {file}.csv\n"


def format_report(found: Found) -> str:
    """Return best settings, comparison with the paper and origin as Markdown."""
    states = [_describe_state(trial) for trial in found.trials]
    n_random = sum(trial.user_attrs["stage"] == "random" for trial in found.trials)
    highest = format_percent(max(trial.value or 0.0 for trial in found.trials))
    recalls = found.best_hits.mean(axis=1), found.paper_hits.mean(axis=1)  # by seed
    best, paper = (f"{format_percent(each.mean())} ± {format_percent(each.std(ddof=1))}" for each in recalls)
    gains = recalls[0] - recalls[1]
    ends = difference_interval(found.best_hits.mean(axis=0), found.paper_hits.mean(axis=0))
    interval = "-" if ends is None else f"{format_signed_percent(ends.low)}, {format_signed_percent(ends.high)}"
    parts = [
        "# Hyperparameter search",
        f"{len(states)} trials of {TITLE} on {found.settings.dataset}: {n_random} random, {len(states) - n_random} on "
        f"a grid around the best of these. Diverged, which counts as R@1 0: {states.count('diverged')}. Failed: "
        f"{states.count('failed')}. A trial trains one network with seed {found.settings.seed} on the searched places "
        "and scores all queries there. No column of the table queries these places.",
        "## Best settings",
        format_markdown(_tabulate_parameters(found)),
        f"R@1 {highest} %, the highest of all trials on the queries that chose it: luck raises it.",
        "## Best against paper",
        f"On {len(found.checked)} places held out, {found.best_hits.shape[1]} queries: R@1 {best} % against {paper} %, "
        f"difference {format_signed_percent(gains.mean())} [{interval}]; best is ahead with {sum(gains > 0)} of "
        f"{SEEDS} seeds.",
        "Both are trained with the same seeds, none of which chose the best; R@1 is mean ± standard deviation over "
        "them, the 95 % interval that of the difference of the per-query means. An interval that holds 0 tells best "
        "and paper not apart.",
        "## Run the best settings",
        f"```\n{format_command(found)}\n```",
        "## Origin",
        f"Places {found.searched[0]} to {found.searched[-1]} were searched, {found.checked[0]} to {found.checked[-1]} "
        f"held out. All trials lie in {found.folder}; the same command goes on there.",
        format_versions(describe_machine("cpu", 1)),
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
        }
        for parameter in PARAMETERS
    ]
