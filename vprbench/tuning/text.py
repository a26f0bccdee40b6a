"""What a search found, for people: Markdown, and every trial as CSV."""

from __future__ import annotations

import csv
import io
import shlex
from collections.abc import Mapping
from pathlib import Path

from vprbench.run.machine import machine_lines
from vprbench.run.rows import markdown
from vprbench.storage.atomic import replace_text
from vprbench.tuning.comparison import AGREE, SEEDS, Comparison, Repeated, Verdict
from vprbench.tuning.objective import StretchName
from vprbench.tuning.search import Found, Settings
from vprbench.tuning.space import PARAMETERS

_FEW = 50  # random trials below which importance is hardly more than chance
_NAMED = 3  # stored runs, at most

_SHORT: dict[StretchName, str] = {"searched": "searched", "checked": "held out"}
_LONG: dict[StretchName, str] = {"searched": "searched (they chose)", "checked": "held out (they chose nothing)"}
_VERDICTS: dict[Verdict, str] = {
    "better": "On the places held out the best settings are better.",
    "worse": "On the places held out the paper's settings are better.",
    "not told apart": "On the places held out, best and paper cannot be told apart.",
}


def write(found: Found, folder: Path) -> str:
    """Leave what was found and every trial in a folder and in that of the study; returns the text to print.

    In the folder the names tell the dataset, where it is not the usual one, and a quick search: search.md and
    search.csv, search-street.md, search-quick.md.
    """
    text, trials = text_of(found), trials_csv(found)
    stem = _stem(found.settings)
    for place, name in ((found.folder, "search"), (folder, stem)):
        replace_text(place / f"{name}.csv", trials)
        replace_text(place / f"{name}.md", text)
    return f"{text}\nwritten to {folder / stem}.md and {folder / stem}.csv, and into {found.folder}\n"


def text_of(found: Found) -> str:
    """Return what was found as Markdown."""
    parts = [
        "# Hyperparameter search",
        _how(found),
        "## Best settings",
        markdown(_parameter_rows(found)),
        _highest_line(found),
        _importance_line(found),
        "## Best against paper",
        markdown([_comparison_row(name, compared) for name, compared in found.compared.items()]),
        *_verdicts(found),
        "Seed by seed:",
        markdown([row for name, compared in found.compared.items() for row in _seed_rows(name, compared)]),
        "## Run the best settings",
        *_warning(found.compared["checked"].verdict),
        f"```\n{command(found)}\n```",
        "## Where this comes from",
        _trials_line(found),
        *_machine(found),
    ]
    return "\n\n".join(parts) + "\n"


def command(found: Found) -> str:
    """Return the command that runs the best settings on the whole dataset."""
    options = ["method=vprtempo", f"dataset={found.settings.dataset}"]
    if found.settings.root is not None:
        options.append(f"dataset.root={found.settings.root}")
    rules = found.method.get("rules", "paper")
    options += [f"method.rules={rules}"] * (rules != "paper")
    if (places := found.dataset.get("places")) is not None and places < found.method["max_module"]:
        options.append(f"method.max_module={places}")
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
        f"searched places and asks all queries there; R@1 is the expected value under ties. {_apart(found)}"
    )


def _apart(found: Found) -> str:
    """Say what else queries these places, or has them in its map."""
    runs = found.queried_by
    if runs:
        more = f" and {len(runs) - _NAMED} more" * (len(runs) > _NAMED)
        told = (
            "No column of the table queries any of these places, but of the stored runs "
            f"{', '.join(runs[:_NAMED])}{more} {'does' if len(runs) == 1 else 'do'}: under the best settings "
            "that is no independent check."
        )
    else:
        told = "No column of the table and no stored run queries any of these places."
    recorded = "seed" not in found.protocols["searched"]
    stay = " As references they stay in the map of reported results, and columns on request may query them."
    return told + stay * recorded


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


def _highest_line(found: Found) -> str:
    recalls = [trial.recall_at_1 for trial in found.trials if trial.recall_at_1 is not None]
    return (
        f"The best trial has R@1 {_percent(found.best.recall_at_1)} %. That is the highest of {len(recalls)} trials, "
        f"all trained with seed {found.settings.seed}, on the queries that chose it: a maximum, which luck raises. "
        "Only the comparison below says what these settings are worth."
    )


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
    ends = compared.interval
    interval = "-" if ends is None else f"{_signed(ends.low)}, {_signed(ends.high)}"
    ahead = sum(difference > 0 for difference in compared.differences)
    return {
        "places": _LONG[name],
        "number": str(compared.n_places),
        "queries": str(compared.n_queries),
        "best R@1 %": _repeated(compared.best),
        "paper R@1 %": _repeated(compared.paper),
        "difference [95 %]": f"{_signed(compared.best.recall_at_1 - compared.paper.recall_at_1)} [{interval}]",
        "seeds with best ahead": f"{ahead} of {len(compared.seeds)}",
    }


def _seed_rows(name: StretchName, compared: Comparison) -> list[dict[str, str]]:
    return [
        {
            "places": _SHORT[name],
            "seed": str(seed),
            "best R@1 %": _percent(compared.best.recalls_at_1[n]),
            "paper R@1 %": _percent(compared.paper.recalls_at_1[n]),
            "difference": _signed(compared.differences[n]),
            "only best right": str(compared.tests[n].b),
            "only paper right": str(compared.tests[n].c),
            "p (McNemar, exact)": f"{compared.tests[n].p_value:.2g}",
        }
        for n, seed in enumerate(compared.seeds)
    ]


def _verdicts(found: Found) -> list[str]:
    searched, checked = found.compared["searched"], found.compared["checked"]
    verdicts = []
    if searched.best.recall_at_1 <= searched.paper.recall_at_1:
        verdicts.append("With these seeds the best settings do not beat the paper's where they were searched either.")
    verdicts.append(_VERDICTS[checked.verdict])
    if checked.interval is None:
        verdicts.append(f"{checked.n_queries} queries are too few for an interval: search more places.")
    verdicts += [
        f"On the places {_SHORT[name]} the training under {whose} settings diverged with {_seeds(compared, repeated)}."
        for name, compared in found.compared.items()
        for whose, repeated in (("the best", compared.best), ("the paper's", compared.paper))
        if any(repeated.diverged)
    ]
    verdicts.append(
        f"Both settings are trained with the same {SEEDS} seeds, none of which chose the best: R@1 is the mean over "
        "them and ± their standard deviation. The interval is that of the difference of per-query mean hits: the wider "
        "one of Agresti and Min's, which takes queries as independent, and that of a bootstrap of blocks of "
        f"neighbouring queries, as long as the queries are found to be alike{_blocks(found.compared)}. One is called "
        f"better only where that interval excludes 0 and {AGREE} or more of the {SEEDS} seeds agree. What the searched "
        "places say holds for no others, because the best settings were chosen there."
    )
    return verdicts


def _blocks(compared: Mapping[StretchName, Comparison]) -> str:
    """Name the lengths of the blocks; nothing without an interval."""
    lengths = [f"{each.interval.block} {_SHORT[name]}" for name, each in compared.items() if each.interval]
    return f" ({', '.join(lengths)})" if lengths else ""


def _seeds(compared: Comparison, repeated: Repeated) -> str:
    """Name the seeds whose training diverged, and how."""
    reasons = {seed: reason for seed, reason in zip(compared.seeds, repeated.diverged, strict=True) if reason}
    return "; ".join(f"seed {seed}: {reason}" for seed, reason in reasons.items())


def _warning(verdict: Verdict) -> list[str]:
    """Return what has to be known before the best settings are used."""
    if verdict == "better":
        return []
    told = "worse than" if verdict == "worse" else "not shown to be better than"
    return [f"On the places held out these settings were {told} the paper's."]


def _trials_line(found: Found) -> str:
    places = " and ".join(
        f"{protocol['stretch'][0]} to {protocol['stretch'][1]} ({_SHORT[name]})"
        for name, protocol in found.protocols.items()
    )
    journey = found.protocols["searched"].get("seed")
    of = "" if journey is None else f" of the journey with seed {journey}"
    return (
        f"Places{of}: {places}. This call tried {found.tried_now} settings in {_duration(found.minutes)}. "
        f"All trials lie in {found.folder}: the same command goes on there."
    )


def _machine(found: Found) -> list[str]:
    here = dict(found.environment)
    _, software = machine_lines(here)
    processes = f"{found.jobs} process{'es' * (found.jobs != 1)} of one thread"
    memory = f"{here['memory_bytes'] / 1e9:.0f} GB"
    return [f"{here['processor']}, {processes} on {here['cores']} cores, {memory}, {here['platform']}.", software]


def _stem(settings: Settings) -> str:
    usual = settings.dataset == Settings.dataset
    return "-".join(["search", *[settings.dataset] * (not usual), *["quick"] * settings.quick])


def _repeated(repeated: Repeated) -> str:
    return f"{_percent(repeated.recall_at_1)} ± {_percent(repeated.spread)}"


def _signed(share: float) -> str:
    return f"{round(100 * share, 1) + 0.0:+.1f}"  # no -0.0


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f}"


def _duration(minutes: float) -> str:
    return f"{60 * minutes:.0f} seconds" if minutes < 2 else f"{minutes:.1f} minutes"


def _symbol(name: str) -> str:
    return next(parameter.symbol for parameter in PARAMETERS if parameter.name == name)
