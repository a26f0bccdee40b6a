"""The facts of runs on the page: findings, machines with versions, and notes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from vprbench.report.ranking import rank_rows
from vprbench.report.selection import MethodRuns
from vprbench.runs.machine import Machine
from vprbench.runs.query_results import RIGHT, UNANSWERABLE, UNJUDGED, Answers
from vprbench.runs.record import Run
from vprbench.runs.tuned import list_notes
from vprbench.text import format_count

_FINDINGS = 3  # sentences

Facts = list[tuple[str, str]]  # (term, text)


def list_findings(series: Sequence[MethodRuns], answers: Iterable[Answers]) -> list[str]:
    """Return at most three sentences on the rows of one dataset: results of tests, then counts of missed queries.

    `answers` are those of their runs.
    """
    found = list(rank_rows(series).sentences)
    kinds = [set(verdicts) for verdicts in zip(*(one.verdicts for one in answers), strict=True)]
    wrong = [RIGHT not in kind for kind in kinds if kind not in ({UNANSWERABLE}, {UNJUDGED})]
    n_runs = sum(len(one.runs) for one in series)
    if n_runs > 1 and wrong:
        by_some = sum(RIGHT in kind and len(kind) > 1 for kind in kinds)
        missed = f"all {n_runs} runs miss {sum(wrong):,}, some runs miss {by_some:,} more"
        found.append(f"Of {format_count(len(wrong), 'query')} {missed}.")
    return found[:_FINDINGS]


def list_machines(series: Iterable[MethodRuns]) -> Facts:
    """Return each machine with its versions, and on a line of its own the runs made there, in the order of the runs."""
    found: dict[tuple[str, str], dict[str, None]] = {}
    for one in series:
        for run in one.runs:
            made_on = Machine.of(run.environment).line, _list_versions(run.environment)
            found.setdefault(made_on, {})[f"{one.name} ({run.dataset})"] = None
    return [(machine, f"{versions}\n{', '.join(runs)}") for (machine, versions), runs in found.items()]


def list_run_notes(measured: Iterable[tuple[str, MethodRuns]]) -> Facts:
    """Return the notes of runs, each after the run's name; `measured` is rows with the titles of their datasets."""
    facts = []
    for title, one in measured:
        for run in one.runs:
            device = "" if run.config.get("device") in (None, "cpu") else f", on {run.config['device']}"
            facts += [(f"{title}: {name_run(one, run)}{device}", note.text) for note in list_notes(run)]
    return facts


def name_run(series: MethodRuns, run: Run) -> str:
    """Return the name of a run within its dataset: that of its row, and its seed if the row has several."""
    return f"{series.name}, seed {run.config['seed']}" if len(series.runs) > 1 else series.name


def _list_versions(environment: Mapping[str, Any]) -> str:
    """Return the versions of vprbench, its commit, Python and the libraries."""
    git = environment.get("git") or {}
    changed = " with changes" if git.get("changed") else ""
    versions = {"vprbench": environment.get("vprbench"), "commit": f"{git['commit'][:12]}{changed}" if git else None}
    versions |= {"Python": environment.get("python"), **environment.get("libraries", {})}
    return ", ".join(f"{name} {version}" for name, version in versions.items() if version)
