"""What a search found, for people: Markdown, and every trial as CSV."""

from __future__ import annotations

import csv
import io
from pathlib import Path

from vprbench.bench_text import machine_lines
from vprbench.intervals import Interval
from vprbench.replacing import replace_text
from vprbench.tables import markdown
from vprbench.tuning.objective import StretchName
from vprbench.tuning.search import Accuracy, Comparison, Found
from vprbench.tuning.space import PARAMETERS

_SEPARATED = 0.05  # p below which best and paper are told apart
_FEW = 50  # random trials below which importance is hardly more than chance

_SHORT: dict[StretchName, str] = {"searched": "searched", "checked": "held out"}
_LONG: dict[StretchName, str] = {"searched": "searched (they chose)", "checked": "held out (they chose nothing)"}


def write(found: Found, folder: Path) -> str:
    """Leave what was found in search.md and every trial in search.csv of a folder; returns the text to print."""
    text = text_of(found)
    replace_text(folder / "search.csv", trials_csv(found))
    replace_text(folder / "search.md", text)
    return f"{text}\nwritten to {folder / 'search.md'} and {folder / 'search.csv'}\n"


def text_of(found: Found) -> str:
    """Return what was found as Markdown."""
    parts = [
        "# Hyperparameter search",
        _how(found),
        "## Best settings",
        markdown(_parameter_rows(found)),
        _importance_line(found),
        "## Best against paper",
        markdown([_comparison_row(name, compared) for name, compared in found.compared.items()]),
        *_verdicts(found),
        "## Run the best settings",
        f"```\n{command(found)}\n```",
        "## Where this comes from",
        _trials_line(found),
        *machine_lines(dict(found.environment)),
    ]
    return "\n\n".join(parts) + "\n"


def command(found: Found) -> str:
    """Return the command that runs the best settings on the whole dataset."""
    rules = found.method.get("rules", "paper")
    options = [f"method.rules={rules}"] * (rules != "paper")
    options += [f"method.{name}={value:g}" for name, value in found.best.values.items()]
    return " ".join(["python -m vprbench method=vprtempo", f"dataset={found.settings.dataset}", *options])


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


def _how(found: Found) -> str:
    done = [trial for trial in found.trials if trial.recall_at_1 is not None]
    diverged = sum(trial.diverged is not None for trial in done)
    n_random = sum(trial.stage == "random" for trial in done)
    failed = len(found.trials) - len(done)
    again = f" Failed or killed, and made up for: {failed}." * (failed > 0)
    return (
        f"{len(done)} trials of VPRTempo on {found.settings.dataset}: {n_random} with random settings, then "
        f"{len(done) - n_random} on a grid of rates and probabilities around the best of those. In {diverged} of them "
        f"the training diverged, which counts as R@1 0.{again} Each trial trains one network from the same seed on the "
        "searched places and asks all queries there; R@1 is the expected value under ties. No reported result queries "
        "any of these places."
    )


def _parameter_rows(found: Found) -> list[dict[str, str]]:
    return [
        {
            "parameter": parameter.symbol,
            "argument": f"method.{parameter.name}",
            "best": f"{found.best.values[parameter.name]:g}",
            "paper": f"{parameter.paper:g}",
            "searched": f"{parameter.low:g} to {parameter.high:g}{' (log)' * parameter.log}",
            "importance %": _percent(found.importance.get(parameter.name)),
        }
        for parameter in PARAMETERS
    ]


def _importance_line(found: Found) -> str:
    n_random = sum(trial.stage == "random" and trial.recall_at_1 is not None for trial in found.trials)
    if not found.importance:
        return f"R@1 was the same in all {n_random} random trials: nothing says which parameters mattered."
    mattered = ", ".join(f"{_symbol(name)} {_percent(share)} %" for name, share in list(found.importance.items())[:3])
    chance = f" {n_random} trials are few for this: read it as a hint." * (n_random < _FEW)
    return (
        f"What mattered most: {mattered}. Importance is the share of a parameter alone in how R@1 varies over the "
        f"{n_random} random trials (fANOVA, shares of all single parameters).{chance}"
    )


def _comparison_row(name: StretchName, compared: Comparison) -> dict[str, str]:
    return {
        "places": _LONG[name],
        "number": str(compared.n_places),
        "queries": str(compared.n_queries),
        "best R@1 % [95 %]": _accuracy(compared.best),
        "paper R@1 % [95 %]": _accuracy(compared.paper),
        "only best right": str(compared.test.b),
        "only paper right": str(compared.test.c),
        "p (McNemar, exact)": f"{compared.test.p_value:.2g}",
    }


def _verdicts(found: Found) -> list[str]:
    searched, checked = found.compared["searched"], found.compared["checked"]
    verdicts = []
    if searched.best.recall_at_1 <= searched.paper.recall_at_1:
        verdicts.append("No trial beats the paper's settings on the searched places: more trials may.")
    if checked.test.p_value >= _SEPARATED:
        verdicts.append("On the places held out, best and paper cannot be told apart.")
    elif checked.test.b > checked.test.c:
        verdicts.append("The best settings are better on the places held out too.")
    else:
        verdicts.append("On the places held out the paper's settings are better.")
    verdicts += [
        f"On the places {_SHORT[name]} the training under {whose} settings diverged: {accuracy.diverged}."
        for name, compared in found.compared.items()
        for whose, accuracy in (("the best", compared.best), ("the paper's", compared.paper))
        if accuracy.diverged is not None
    ]
    verdicts.append(
        "Intervals are Wilson's and take queries as independent. On the searched places p says nothing about other "
        "places, because the best settings were chosen there."
    )
    return verdicts


def _trials_line(found: Found) -> str:
    places = " and ".join(
        f"{protocol['stretch'][0]} to {protocol['stretch'][1]} ({_SHORT[name]})"
        for name, protocol in found.protocols.items()
    )
    journey = found.protocols["searched"].get("seed")
    of = "" if journey is None else f" of the journey with seed {journey}"
    return (
        f"Places{of}: {places}. This call tried {found.tried_now} settings in {_duration(found.minutes)}, "
        f"{found.jobs} at a time, one thread each. All trials lie in {found.folder}: the same command goes on there."
    )


def _accuracy(accuracy: Accuracy) -> str:
    return f"{_percent(accuracy.recall_at_1)} [{_ends(accuracy.interval)}]"


def _ends(interval: Interval) -> str:
    return f"{_percent(interval.low)}, {_percent(interval.high)}"


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f}"


def _duration(minutes: float) -> str:
    return f"{60 * minutes:.0f} seconds" if minutes < 2 else f"{minutes:.1f} minutes"


def _symbol(name: str) -> str:
    return next(parameter.symbol for parameter in PARAMETERS if parameter.name == name)
