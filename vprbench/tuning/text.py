"""The answer of a search: Markdown, and every trial as CSV."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from pathlib import Path

import pandas as pd

from vprbench.runs.machine import format_software
from vprbench.runs.rows import format_markdown
from vprbench.storage.atomic import replace_text
from vprbench.text import format_percent, format_signed_percent
from vprbench.tuning.comparison import AGREE, SEEDS, Comparison, Repeated, Verdict
from vprbench.tuning.objective import StretchName
from vprbench.tuning.search import Found
from vprbench.tuning.settings import Settings
from vprbench.tuning.space import METHOD, PARAMETERS, TITLE

_PLACES: dict[StretchName, str] = {"searched": "searched (they chose)", "checked": "held out (they chose nothing)"}
_VERDICTS: dict[Verdict, str] = {
    "better": "the best settings are better",
    "worse": "the paper's settings are better",
    "not told apart": "best and paper cannot be told apart",
}


def write(found: Found, folder: Path) -> str:
    """Write the report and every trial into a folder and into the folder of the study; returns the text to print.

    In the folder the names tell an unusual dataset and a quick search: search.md and search.csv, search-nordland.md,
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
    done = [trial for trial in found.trials if trial.recall_at_1 is not None]
    n_random = sum(trial.stage == "random" for trial in done)
    n_diverged = sum(trial.diverged is not None for trial in done)
    stretches = [protocol["stretch"] for protocol in found.protocols.values()]
    here = found.environment
    parts = [
        "# Hyperparameter search",
        f"{len(done)} trials of {TITLE} on {found.settings.dataset}: {n_random} random, {len(done) - n_random} on a "
        f"grid around the best of these. Diverged, which counts as R@1 0: {n_diverged}. Failed: "
        f"{len(found.trials) - len(done)}. A trial trains one network with seed {found.settings.seed} on the searched "
        "places and scores all queries there. No column of the table queries these places; stored runs that query "
        f"them: {', '.join(found.queried_by) or 'none'}.",
        "## Best settings",
        format_markdown(_tabulate_parameters(found)),
        f"R@1 {format_percent(found.best.recall_at_1)} %, the highest of {len(done)} trials on the queries that chose "
        "it: luck raises it, the comparison below does not use it. Importance is a parameter's share in how R@1 varies "
        f"over the random trials (fANOVA).{' R@1 did not vary.' * (not found.importance)}",
        "## Best against paper",
        format_markdown([_summarise_comparison(name, compared) for name, compared in found.compared.items()]),
        f"Held out: {_VERDICTS[found.compared['checked'].verdict]}. Both are trained with the same {SEEDS} seeds, none "
        "of which chose the best; R@1 is mean ± standard deviation over them, the interval that of the difference of "
        f"the per-query means. Better needs an interval without 0 and {AGREE} of {SEEDS} seeds.",
        *_list_divergences(found),
        format_markdown([row for name, compared in found.compared.items() for row in _tabulate_seeds(name, compared)]),
        "## Run the best settings",
        f"```\n{format_command(found)}\n```",
        "## Origin",
        f"Places {stretches[0][0]} to {stretches[0][1]} were searched, {stretches[1][0]} to {stretches[1][1]} held out"
        f"{_name_journey(found)}. This call tried {found.tried_now} settings in {found.minutes:.1f} minutes. "
        f"All trials lie in {found.folder}; the same command goes on there.",
        f"{here['processor']}, {found.jobs} processes of one thread on {here['cores']} cores, "
        f"{here['memory_bytes'] / 1e9:.0f} GB, {here['platform']}. {format_software(here)}",
    ]
    return "\n\n".join(parts) + "\n"


def format_command(found: Found) -> str:
    """Return the command that runs the best settings on the whole dataset."""
    options = [f"method={METHOD}", f"dataset={found.settings.dataset}"]
    if found.settings.root is not None:
        options.append(f"dataset.root={found.settings.root}")
    options += [f"method.{name}={value:g}" for name, value in found.best.values.items()]
    return " ".join(["python -m vprbench", *map(shlex.quote, options)])


def format_trials(found: Found) -> str:
    """Return every trial as a line of CSV, failed ones without R@1."""
    return pd.DataFrame(
        {
            "trial": trial.number,
            "stage": trial.stage,
            "state": "failed" if trial.recall_at_1 is None else "done" if trial.diverged is None else "diverged",
            "recall_at_1": trial.recall_at_1,
            **{parameter.name: trial.values.get(parameter.name) for parameter in PARAMETERS},
            "seconds": trial.seconds,
            "reason": trial.diverged or trial.failed or "the search was ended meanwhile" * (trial.recall_at_1 is None),
        }
        for trial in found.trials
    ).to_csv(index=False)


def _name_journey(found: Found) -> str:
    seed = found.protocols["searched"].get("seed")
    return "" if seed is None else f" (journey {seed})"


def _tabulate_parameters(found: Found) -> list[dict[str, str]]:
    return [
        {
            "parameter": parameter.symbol,
            "argument": f"method.{parameter.name}",
            "best": f"{found.best.values[parameter.name]:g}",
            "paper": f"{parameter.paper:g}",
            "searched": f"{parameter.low:g} to {parameter.high:g}{' (log)' * parameter.log}",
            "importance %": format_percent(found.importance.get(parameter.name)),
        }
        for parameter in PARAMETERS
    ]


def _summarise_comparison(name: StretchName, compared: Comparison) -> dict[str, str]:
    ends = compared.interval
    interval = "-" if ends is None else f"{format_signed_percent(ends.low)}, {format_signed_percent(ends.high)}"
    difference = compared.best.recall_at_1 - compared.paper.recall_at_1
    return {
        "places": _PLACES[name],
        "number": str(compared.n_places),
        "queries": str(compared.n_queries),
        "best R@1 %": _format_repeated(compared.best),
        "paper R@1 %": _format_repeated(compared.paper),
        "difference [95 %]": f"{format_signed_percent(difference)} [{interval}]",
        "seeds with best ahead": f"{sum(each > 0 for each in compared.differences)} of {len(compared.seeds)}",
    }


def _tabulate_seeds(name: StretchName, compared: Comparison) -> Iterator[dict[str, str]]:
    for n, (seed, test) in enumerate(zip(compared.seeds, compared.tests, strict=True)):
        yield {
            "places": name,
            "seed": str(seed),
            "best R@1 %": format_percent(compared.best.recalls_at_1[n]),
            "paper R@1 %": format_percent(compared.paper.recalls_at_1[n]),
            "difference": format_signed_percent(compared.differences[n]),
            "only best right": str(test.b),
            "only paper right": str(test.c),
            "p (McNemar, exact)": f"{test.p_value:.2g}",
        }


def _list_divergences(found: Found) -> Iterator[str]:
    """Yield a line for each training of the comparison that diverged."""
    for name, compared in found.compared.items():
        for settings, repeated in (("best", compared.best), ("paper", compared.paper)):
            for seed, how in zip(compared.seeds, repeated.diverged, strict=True):
                if how:
                    yield f"Diverged on the {name} places, {settings} settings, seed {seed}: {how}."


def _format_repeated(repeated: Repeated) -> str:
    return f"{format_percent(repeated.recall_at_1)} ± {format_percent(repeated.recall_at_1_std)}"
