"""The facts of runs on the page: findings, protocol, machines and notes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from vprbench.paper.ranking import rank_rows
from vprbench.paper.selection import Series
from vprbench.runs.machine import Machine
from vprbench.runs.query_results import RIGHT, UNANSWERABLE, UNJUDGED, Answers
from vprbench.runs.record import Run
from vprbench.runs.tuned import list_notes
from vprbench.text import format_gigabytes, plural

_FINDINGS = 3  # sentences
_STATED = {  # parts of a protocol that the page names in their own facts
    *("references", "reference", "query", "queries", "places", "query_places"),
    *("tolerance_places", "tolerance_frames", "radius_metres", "tolerance_metres"),
}

Facts = tuple[tuple[str, str], ...]  # (term, text)


def list_findings(series: Sequence[Series], answers: Iterable[Answers]) -> list[str]:
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
        found.append(f"Of {plural(len(wrong), 'query')} {missed}.")
    return found[:_FINDINGS]


def list_protocol(runs: Sequence[Run]) -> Facts:
    """Return the facts on places, queries, right places and timing, for runs of one dataset and protocol."""
    run, given = runs[0], runs[0].protocol
    timings = dict.fromkeys(_describe_timing(asked) for one in runs if (asked := one.config.get("timing")))
    recorded = {name: value for name, value in given.items() if name not in _STATED and value is not None}
    references = plural(run.n_references, "reference image")
    return _keep_known(
        ("Dataset", f"{run.dataset}, images {run.fingerprint[:16]}"),
        ("Map", f"{plural(run.outcome.n_places, 'place')}, from {references}{_name_traverses(given, 'references')}"),
        ("Queries", f"{plural(len(run.positives), 'image')}{_name_traverses(given, 'query', 'queries')}"),
        ("Right places", _describe_right_places(run) if run.is_judged else "no ground truth"),
        ("Also recorded", "; ".join(f"{name.replace('_', ' ')}: {_join(value)}" for name, value in recorded.items())),
        *(("Timing", timing) for timing in timings),
    )


def list_machines(series: Iterable[Series]) -> list[tuple[str, Facts]]:
    """Return the recorded facts of each machine after its name, in the order of the runs."""
    found: dict[object, list[tuple[str, Run]]] = {}
    for one in series:
        for run in one.runs:
            found.setdefault(Machine.of(run.environment).hardware, []).append((one.name, run))
    return [(f"Machine {number}", _list_machine(runs)) for number, runs in enumerate(found.values(), 1)]


def list_run_notes(measured: Iterable[tuple[str, Series]]) -> Facts:
    """Return the notes of runs, each after the run's name; `measured` is rows with the titles of their datasets."""
    return tuple(
        (f"{title}: {name_run(one, run)}{_name_device(run)}", note.text)
        for title, one in measured
        for run in one.runs
        for note in list_notes(run)
    )


def describe_first_references(runs: Sequence[Run], names: Iterable[str]) -> str:
    """Return which of several reference images of a place is shown; empty if no place has several.

    `names` are those of the reference images that are shown; a folder that holds all of them names the traverse.
    """
    if all(run.n_references <= run.outcome.n_places for run in runs):
        return ""
    folders = {name.rpartition("/")[0] for name in names}
    traverse = f" ({folders.pop()})" if len(folders) == 1 and folders != {""} else ""
    return f"The frame of a place is its first reference image{traverse}; methods learnt the other ones too."


def name_run(series: Series, run: Run) -> str:
    """Return the name of a run within its dataset: that of its row, and its seed if the row has several."""
    return f"{series.name}, seed {run.config['seed']}" if len(series.runs) > 1 else series.name


def _name_device(run: Run) -> str:
    return "" if run.config.get("device") in (None, "cpu") else f", on {run.config['device']}"


def _name_traverses(given: Mapping[str, Any], *names: str) -> str:
    return "".join(f" ({_join(given[name])})" for name in names if name in given)


def _describe_right_places(run: Run) -> str:
    counts = [len(right) for right in run.positives]
    within = [
        f"within {run.protocol[name]:g} {unit}"
        for name, unit in (
            *(("tolerance_places", "places"), ("tolerance_frames", "frames")),
            *(("radius_metres", "m"), ("tolerance_metres", "m")),
        )
        if run.protocol.get(name) is not None
    ]
    known = [count for count in counts if count]
    without = len(counts) - len(known)
    parts = [*within, f"{_format_range(known, 'd')} of a query" if known else ""]
    parts.append(f"none of {plural(without, 'query')}" if without else "")
    return "; ".join(filter(None, parts))


def _describe_timing(asked: Mapping[str, Any]) -> str:
    if not asked.get("rates", True):
        return "no query rates"
    most = asked.get("total_seconds")
    return (
        f"at least {asked['minimum_seconds']:g} s and {plural(asked['minimum_queries'], 'query')} from a sample of "
        f"{plural(asked['sample'], 'image')} in memory; warm-up of at most {plural(asked['warmup_queries'], 'query')}"
        f"{f'; at most {most:g} s for all batch sizes' if most else ''}"
    )


def _list_machine(named: Sequence[tuple[str, Run]]) -> Facts:
    """Return the facts in the records of one machine's runs: each term once, with all that was recorded."""
    surroundings = [run.environment for _, run in named]
    facts: dict[str, dict[str, None]] = {}
    for term, text in (fact for known in surroundings for fact in _list_surroundings(known)):
        facts.setdefault(term, {})[text] = None
    loads = [known["load_average"][0] for known in surroundings if known.get("load_average")]
    waiting = [share for known in surroundings if (share := known.get("cpu_pressure_avg10")) is not None]
    days = sorted({known["time_utc"][:10] for known in surroundings if known.get("time_utc")})
    return _keep_known(
        *((term, "; ".join(texts)) for term, texts in facts.items()),
        ("Load before a run", f"{_format_range(loads, '.2g')} processes on average over a minute" if loads else ""),
        ("Waiting for a core", f"{_format_range(waiting, '.2g')} % of the 10 s before a run" if waiting else ""),
        ("Dates", " to ".join(dict.fromkeys([days[0], days[-1]])) if days else ""),
        ("Runs", "; ".join(dict.fromkeys(f"{name} ({run.dataset})" for name, run in named))),
    )


def _list_surroundings(known: Mapping[str, Any]) -> Facts:
    """Return the facts of one record's environment."""
    git, memory, on_board = known.get("git") or {}, known.get("memory_bytes"), known.get("accelerator_memory_bytes")
    commit = f"{git['commit'][:12]}{' with changes' if git.get('changed') else ''}" if git.get("commit") else ""
    libraries = [f"{name} {version}" for name, version in known.get("libraries", {}).items() if version is not None]
    return _keep_known(
        ("Processor", known.get("processor")),
        ("Threads", f"{known['threads']} of {plural(known['cores'], 'core')}" if known.get("cores") else None),
        ("Memory", format_gigabytes(memory) if memory else None),
        ("Accelerator", known.get("accelerator")),
        ("Accelerator memory", format_gigabytes(on_board) if on_board else None),
        ("Driver", known.get("driver")),
        ("CUDA", known.get("cuda") if known.get("driver") else None),
        ("System", known.get("platform")),
        ("Clock governor", known.get("governor")),
        ("Python", known.get("python")),
        ("vprbench", known.get("vprbench")),
        ("Commit", commit or "not recorded"),
        ("Libraries", ", ".join(libraries)),
    )


def _keep_known(*facts: tuple[str, str | None]) -> Facts:
    return tuple((term, str(text)) for term, text in facts if text)


def _format_range(values: Sequence[float], digits: str) -> str:
    return " to ".join(dict.fromkeys(format(value, digits) for value in (min(values), max(values))))


def _join(value: object) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_join(part)}" for name, part in value.items())
    return " and ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
