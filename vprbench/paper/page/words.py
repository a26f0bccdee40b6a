"""What a reader of the numbers has to know of the runs, in words: protocol, machines and notes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from vprbench.paper.ranking import ranked
from vprbench.paper.selection import Series
from vprbench.paper.templates import ENVIRONMENT, sentences
from vprbench.runs.machine import Machine
from vprbench.runs.query_results import RIGHT, UNANSWERABLE, UNJUDGED, Answers
from vprbench.runs.record import Run
from vprbench.runs.tuned import all_notes
from vprbench.text import format_gigabytes

_FINDINGS = 3  # sentences

Facts = tuple[tuple[str, str], ...]  # terms, each with what is said of it


def findings(series: Sequence[Series], answers: Iterable[Answers]) -> list[str]:
    """Return at most three sentences on the series of one dataset: what tests say, then which queries were missed.

    `answers` are those of their runs.
    """
    found = list(ranked(series).sentences)
    kinds = [set(verdicts) for verdicts in zip(*(one.verdicts for one in answers), strict=True)]
    wrong = [RIGHT not in kind for kind in kinds if kind not in ({UNANSWERABLE}, {UNJUDGED})]
    n_runs = sum(len(one.runs) for one in series)
    if n_runs > 1 and wrong:
        by_some = sum(RIGHT in kind and len(kind) > 1 for kind in kinds)
        what = "run" if n_runs > len(series) else "method"
        found += sentences("page/words.j2", "missed", len(wrong), sum(wrong), by_some, what)
    return found[:_FINDINGS]


def protocol(runs: Sequence[Run]) -> Facts:
    """Say what was asked of which places, for runs of one dataset and protocol."""
    timings: list[Any] = []
    for run in runs:
        asked = run.config.get("timing")
        timings += [asked] if asked and asked not in timings else []
    return _facts("protocol", runs[0], [len(right) for right in runs[0].positives], timings)


def machines(series: Iterable[Series]) -> list[tuple[str, Facts]]:
    """Return what is recorded of each machine after its name, in the order of the runs."""
    found: dict[object, list[tuple[str, Run]]] = {}
    for one in series:
        for run in one.runs:
            found.setdefault(Machine.of(run.environment).hardware, []).append((one.name, run))
    return [(f"Machine {number}", _machine(runs)) for number, runs in enumerate(found.values(), 1)]


def notes(measured: Iterable[tuple[str, Series]]) -> tuple[tuple[str, str], ...]:
    """Return the notes of runs, each with the run that it is about; `measured` is series with their datasets' titles.

    The device is named of runs that were not made on the CPU.
    """
    return tuple(
        (f"{title}: {run_name(one, run)}{_recall_off_tuned_places(run)}", note.text)
        for title, one in measured
        for run in one.runs
        for note in all_notes(run)
    )


def first_references(runs: Sequence[Run], names: Iterable[str]) -> str:
    """Say which of several reference images of a place is shown; empty if no place has several.

    `names` are those of the reference images that are shown; where all lie in one folder it names the traverse.
    """
    if all(run.n_references <= run.outcome.n_places for run in runs):
        return ""
    return " ".join(sentences("page/words.j2", "first_references", list({name.rpartition("/")[0] for name in names})))


def run_name(series: Series, run: Run) -> str:
    """Return the name of a run within its dataset: that of its row, and its seed if the row has several."""
    return f"{series.name}, seed {run.config['seed']}" if len(series.runs) > 1 else series.name


def _recall_off_tuned_places(run: Run) -> str:
    return "" if run.config.get("device") in (None, "cpu") else f", on {run.config['device']}"


def _machine(named: Sequence[tuple[str, Run]]) -> Facts:
    """Return what the records of one machine's runs say of it: each term once, with all that was recorded."""
    surroundings = [run.environment for _, run in named]
    facts: dict[str, dict[str, None]] = {}
    for term, text in (fact for known in surroundings for fact in _facts("machine", known)):
        facts.setdefault(term, {})[text] = None
    libraries: dict[str, list[str]] = {}
    for name, version in (item for known in surroundings for item in known.get("libraries", {}).items()):
        libraries.setdefault(name, []).extend([version] if version is not None else [])
    ran = _facts(
        "ran",
        {name: versions for name, versions in libraries.items() if versions},
        [known["load_average"][0] for known in surroundings if known.get("load_average")],
        [share for known in surroundings if (share := known.get("cpu_pressure_avg10")) is not None],
        [known["time_utc"][:10] for known in surroundings if known.get("time_utc")],
        [f"{name} ({run.dataset})" for name, run in named],
    )
    return (*((term, "; ".join(texts)) for term, texts in facts.items()), *ran)


def _facts(macro: str, *values: Any) -> Facts:
    lines = (line.partition(": ") for line in sentences("page/words.j2", macro, *values))
    return tuple((term, text) for term, _, text in lines)


def _plain(value: object) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_plain(part)}" for name, part in value.items())
    return " and ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


def _besides(recorded: tuple[str, object]) -> str:
    return f"{recorded[0].replace('_', ' ')}: {_plain(recorded[1])}"


def _gigabytes(amount: float | None) -> str:
    return format_gigabytes(amount) if amount else ""


ENVIRONMENT.filters |= {"plain": _plain, "besides": _besides, "gigabytes": _gigabytes}
