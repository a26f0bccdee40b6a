"""What a search found, for people: Markdown, and every trial as CSV."""

from __future__ import annotations

import csv
import io
import shlex
from collections.abc import Iterator
from pathlib import Path

from vprbench.runs.machine import format_software
from vprbench.runs.rows import render_template
from vprbench.storage.atomic import replace_text
from vprbench.text import format_percent, format_signed_percent
from vprbench.tuning.comparison import AGREE, SEEDS, Comparison, Repeated
from vprbench.tuning.objective import StretchName
from vprbench.tuning.search import Found
from vprbench.tuning.settings import Settings
from vprbench.tuning.space import METHOD, PARAMETERS, TITLE

_FEW = 50  # random trials below which importance is hardly more than chance
_NAMED = 3  # stored runs, at most

_SHORT: dict[StretchName, str] = {"searched": "searched", "checked": "held out"}
_LONG: dict[StretchName, str] = {"searched": "searched (they chose)", "checked": "held out (they chose nothing)"}
_SYMBOLS = {parameter.name: parameter.symbol for parameter in PARAMETERS}
_TEMPLATE = Path(__file__).with_name("search.md.j2")


def write(found: Found, folder: Path) -> str:
    """Write the report and every trial into a folder and into the folder of the study; returns the text to print.

    In the folder the names tell an unusual dataset and a quick search: search.md and
    search.csv, search-street.md, search-quick.md.
    """
    text, trials = to_text(found), trials_csv(found)
    stem = _stem(found.settings)
    for place, name in ((found.folder, "search"), (folder, stem)):
        replace_text(place / f"{name}.csv", trials)
        replace_text(place / f"{name}.md", text)
    return f"{text}\nwritten to {folder / stem}.md and {folder / stem}.csv, and into {found.folder}\n"


def to_text(found: Found) -> str:
    """Return what was found as Markdown."""
    done = [trial for trial in found.trials if trial.recall_at_1 is not None]
    return render_template(
        _TEMPLATE,
        found=found,
        n_done=len(done),
        n_random=sum(trial.stage == "random" for trial in done),
        n_diverged=sum(trial.diverged is not None for trial in done),
        parameters=_parameter_rows(found),
        mattered=", ".join(
            f"{_SYMBOLS[name]} {format_percent(share)} %" for name, share in [*found.importance.items()][:3]
        ),
        comparisons=[_comparison_row(name, compared) for name, compared in found.compared.items()],
        seeds=[row for name, compared in found.compared.items() for row in _seed_rows(name, compared)],
        searched=found.compared["searched"],
        checked=found.compared["checked"],
        diverged=list(_diverged(found)),
        blocks=", ".join(f"{of.interval.block} {_SHORT[name]}" for name, of in found.compared.items() if of.interval),
        command=command(found),
        duration=f"{60 * found.minutes:.0f} seconds" if found.minutes < 2 else f"{found.minutes:.1f} minutes",
        here=found.environment,
        software=format_software(found.environment),
        percent=format_percent,
        **{"AGREE": AGREE, "SEEDS": SEEDS, "FEW": _FEW, "NAMED": _NAMED, "SHORT": _SHORT, "TITLE": TITLE},
    )


def command(found: Found) -> str:
    """Return the command that runs the best settings on the whole dataset."""
    options = [f"method={METHOD}", f"dataset={found.settings.dataset}"]
    if found.settings.root is not None:
        options.append(f"dataset.root={found.settings.root}")
    options += [f"method.{name}={value:g}" for name, value in found.best.values.items()]
    return " ".join(["python -m vprbench", *map(shlex.quote, options)])


def trials_csv(found: Found) -> str:
    """Return every trial as a line of CSV, those that failed without R@1."""
    table = io.StringIO()
    names = [parameter.name for parameter in PARAMETERS]
    lines = csv.writer(table, lineterminator="\n")
    lines.writerow(["trial", "stage", "state", "recall_at_1", *names, "seconds", "reason"])
    for trial in found.trials:
        failed = trial.recall_at_1 is None
        state = "failed" if failed else "done" if trial.diverged is None else "diverged"
        reason = trial.diverged or trial.failed or "the search was ended meanwhile" * failed
        values = [trial.values.get(name) for name in names]
        lines.writerow([trial.number, trial.stage, state, trial.recall_at_1, *values, trial.seconds, reason])
    return table.getvalue()


def _parameter_rows(found: Found) -> list[dict[str, str]]:
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


def _comparison_row(name: StretchName, compared: Comparison) -> dict[str, str]:
    ends = compared.interval
    interval = "-" if ends is None else f"{format_signed_percent(ends.low)}, {format_signed_percent(ends.high)}"
    ahead = sum(each > 0 for each in compared.differences)
    difference = compared.best.recall_at_1 - compared.paper.recall_at_1
    return {
        "places": _LONG[name],
        "number": str(compared.n_places),
        "queries": str(compared.n_queries),
        "best R@1 %": _repeated(compared.best),
        "paper R@1 %": _repeated(compared.paper),
        "difference [95 %]": f"{format_signed_percent(difference)} [{interval}]",
        "seeds with best ahead": f"{ahead} of {len(compared.seeds)}",
    }


def _seed_rows(name: StretchName, compared: Comparison) -> list[dict[str, str]]:
    return [
        {
            "places": _SHORT[name],
            "seed": str(seed),
            "best R@1 %": format_percent(compared.best.recalls_at_1[n]),
            "paper R@1 %": format_percent(compared.paper.recalls_at_1[n]),
            "difference": format_signed_percent(compared.differences[n]),
            "only best right": str(compared.tests[n].b),
            "only paper right": str(compared.tests[n].c),
            "p (McNemar, exact)": f"{compared.tests[n].p_value:.2g}",
        }
        for n, seed in enumerate(compared.seeds)
    ]


def _diverged(found: Found) -> Iterator[tuple[str, str, str]]:
    """Yield on which places the training diverged, under whose settings, with which seeds and how."""
    for name, compared in found.compared.items():
        for whose, repeated in (("the best", compared.best), ("the paper's", compared.paper)):
            reasons = [
                f"seed {seed}: {how}" for seed, how in zip(compared.seeds, repeated.diverged, strict=True) if how
            ]
            if reasons:
                yield _SHORT[name], whose, "; ".join(reasons)


def _stem(settings: Settings) -> str:
    usual = settings.dataset == Settings.dataset
    return "-".join(["search", *[settings.dataset] * (not usual), *["quick"] * settings.quick])


def _repeated(repeated: Repeated) -> str:
    return f"{format_percent(repeated.recall_at_1)} ± {format_percent(repeated.recall_at_1_std)}"
