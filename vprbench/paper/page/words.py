"""What a reader of the numbers has to know of the runs, in words: protocol, machines and notes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from vprbench.paper.selection import Series
from vprbench.run.record import Run
from vprbench.run.tuned import all_notes

Facts = tuple[tuple[str, str], ...]  # terms, each with what is said of it

_TRAVERSES = ("references", "reference")
_QUERIES = ("query", "queries")
_TOLERANCES = {"tolerance_places": "place", "tolerance_frames": "frame"}
_COUNTS = ("places", "query_places")  # told by what was counted
_PROTOCOLS = {
    "27k": "all 27,592 frames in the map and as queries, right within 25 m, as VPR-datasets-downloader has it",
    "patchnetvlad": "all 27,592 frames in the map and as queries, right within 7 frames, as Patch-NetVLAD has it",
    "vprbench": "all 27,592 frames in the map, every 10th a query, right within a frame, as VPR-Bench has it",
    "vprtempo": "all places are in the map, those before the first query place too",
    "vprsnn": "the places held out, drawn from all over the journey, are in neither the map nor the queries",
}
_RADII = ("radius_metres", "tolerance_metres")


@dataclass(frozen=True)
class Machine:
    """One machine, with everything that was stored on it."""

    name: str
    facts: Facts


def protocol(runs: Sequence[Run]) -> Facts:
    """Say what was asked of which places, for runs of one dataset and protocol."""
    run = runs[0]
    told = {*_TRAVERSES, *_QUERIES, *_TOLERANCES, *_RADII, *_COUNTS}
    known = str(run.protocol.get("protocol"))
    if known in _PROTOCOLS:
        told.add("protocol")
    besides = [
        f"{name.replace('_', ' ')}: {_plain(value)}"
        for name, value in run.protocol.items()
        if name not in told and value is not None
    ]
    learnt = f"{_count(run.outcome.n_places, 'place')}, from {_count(run.n_references, 'reference image')}"
    facts = [
        ("Dataset", f"{run.dataset}, images {run.fingerprint[:16]}"),
        ("Map", learnt + _traverses(run.protocol, _TRAVERSES)),
        ("Queries", _count(len(run.outcome), "image") + _traverses(run.protocol, _QUERIES)),
        ("Right places", _right_places(run)),
    ]
    if known in _PROTOCOLS:
        facts.append(("Protocol", f"{known}: {_PROTOCOLS[known]}"))
    if besides:
        facts.append(("Also recorded", "; ".join(besides)))
    timing = [words for words in dict.fromkeys(_timing(run.config.get("timing")) for run in runs) if words]
    return (*facts, *(("Timing", words) for words in timing))


def machines(series: Iterable[Series]) -> tuple[Machine, ...]:
    """Return what is recorded of each machine, in the order of the runs."""
    found: dict[tuple[Any, ...], list[tuple[str, Run]]] = {}
    for one in series:
        for run in one.runs:
            found.setdefault(_identity(run.environment), []).append((one.name, run))
    return tuple(_machine(number, runs) for number, runs in enumerate(found.values(), 1))


def notes(measured: Iterable[tuple[str, Series]]) -> tuple[tuple[str, str], ...]:
    """Return the notes of runs, each with the run that it is about; `measured` is series with their datasets' titles.

    The device is named of runs that were not made on the CPU.
    """
    return tuple(
        (f"{title}: {run_name(one, run)}{_elsewhere(run)}", note.text)
        for title, one in measured
        for run in one.runs
        for note in all_notes(run)
    )


def first_references(runs: Sequence[Run], names: Iterable[str]) -> str:
    """Say which of several reference images of a place is shown; empty where no place has several.

    `names` are those of the reference images that are shown; where all lie in one folder it names the traverse.
    """
    if all(run.n_references <= run.outcome.n_places for run in runs):
        return ""
    folders = {name.rpartition("/")[0] for name in names}
    traverse = next(iter(folders)) if len(folders) == 1 else ""
    return (
        f"The frame of a place is always its first reference image{traverse and f', of the traverse {traverse}'}; "
        "the methods learnt its other reference images too."
    )


def run_name(series: Series, run: Run) -> str:
    """Return the name of a run within its dataset: that of its row, and its seed where there are several."""
    return f"{series.name}, seed {run.config['seed']}" if len(series.runs) > 1 else series.name


def _elsewhere(run: Run) -> str:
    return "" if run.config.get("device") in (None, "cpu") else f", on {run.config['device']}"


def _right_places(run: Run) -> str:
    sentences = []
    for name, unit in _TOLERANCES.items():
        if name in run.protocol:
            apart = run.protocol[name]
            near = f"A {unit} up to {_count(apart, unit)} from the one that the query shows is right."
            sentences.append(near if apart else f"Only the {unit} that the query shows is right.")
    sentences += [
        f"A place within {run.protocol[name]:g} m of the query is right." for name in _RADII if name in run.protocol
    ]
    counts = [len(right) for right in run.positives if len(right)]
    if counts and max(counts) > 1:
        low, high = min(counts), max(counts)
        sentences.append(f"A query has {low if low == high else f'{low} to {high}'} of them.")
    without = len(run.positives) - len(counts)
    if without:
        sentences.append(f"{_count(without, 'query has', 'queries have')} none and cannot be answered.")
    return " ".join(sentences) or "One for each query."


def _traverses(protocol: Mapping[str, Any], names: Sequence[str]) -> str:
    named = [_plain(protocol[name]) for name in names if name in protocol]
    return f" ({named[0]})" if named else ""


def _timing(timing: Mapping[str, Any] | None) -> str:
    if not timing:
        return ""
    return (
        f"At least {timing['minimum_seconds']:g} s and {_count(timing['minimum_queries'], 'query', 'queries')} from a "
        f"sample of {_count(timing['sample'], 'image')} in memory, after a warm-up of at most "
        f"{_count(timing['warmup_queries'], 'query', 'queries')}"
    )


def _identity(surroundings: Mapping[str, Any]) -> tuple[Any, ...]:
    return tuple(
        surroundings.get(name) for name in ("processor", "cores", "threads", "memory_bytes", "accelerator", "platform")
    )


def _machine(number: int, named: Sequence[tuple[str, Run]]) -> Machine:
    first = named[0][1].environment
    all_of_it = [run.environment for _, run in named]
    accelerator = first.get("accelerator")
    facts = {
        "Processor": first.get("processor"),
        "Threads": f"{first['threads']} of {_count(first['cores'], 'core')}" if first.get("cores") else "",
        "Memory": _gigabytes(first.get("memory_bytes")),
        "Accelerator": accelerator and f"{accelerator}, {_gigabytes(first.get('accelerator_memory_bytes'))}",
        "Driver": _several(f"{e['driver']}, CUDA {e.get('cuda')}" for e in all_of_it if e.get("driver")),
        "System": first.get("platform"),
        "Clock governor": _several(e["governor"] for e in all_of_it if e.get("governor")),
        "Python": _several(e["python"] for e in all_of_it if e.get("python")),
        "vprbench": _several(e["vprbench"] for e in all_of_it if e.get("vprbench")),
        "Libraries": _libraries(all_of_it),
        "Commit": _several(map(_commit, all_of_it)),
        "Load before a run": _load(all_of_it),
        "Waiting for a core": _range([e.get("cpu_pressure_avg10") for e in all_of_it], " % of the 10 s before a run"),
        "Dates": _dates(all_of_it),
        "Runs": _several(f"{name} ({run.dataset})" for name, run in named),
    }
    return Machine(f"Machine {number}", tuple((term, text) for term, text in facts.items() if text))


def _libraries(surroundings: Sequence[Mapping[str, Any]]) -> str:
    versions: dict[str, list[str]] = {}
    for one in surroundings:
        for name, version in one.get("libraries", {}).items():
            if version is not None:
                versions.setdefault(name, []).append(version)
    return ", ".join(f"{name} {' and '.join(dict.fromkeys(found))}" for name, found in versions.items())


def _commit(surroundings: Mapping[str, Any]) -> str:
    git = surroundings.get("git")
    if not git or not git.get("commit"):
        return "not recorded"
    return f"{git['commit'][:12]}{' with changes that are not committed' if git.get('changed') else ''}"


def _load(surroundings: Sequence[Mapping[str, Any]]) -> str:
    averages = [one["load_average"][0] for one in surroundings if one.get("load_average")]
    return _range(averages, " processes on average over a minute")


def _dates(surroundings: Sequence[Mapping[str, Any]]) -> str:
    days = sorted({one["time_utc"][:10] for one in surroundings if one.get("time_utc")})
    return " to ".join(dict.fromkeys([days[0], days[-1]])) if days else ""


def _range(values: Sequence[float | None], unit: str) -> str:
    known = [value for value in values if value is not None]
    if not known:
        return ""
    low, high = f"{min(known):.2g}", f"{max(known):.2g}"
    return f"{low if low == high else f'{low} to {high}'}{unit}"


def _several(texts: Iterable[str]) -> str:
    return "; ".join(dict.fromkeys(texts))


def _gigabytes(amount: float | None) -> str:
    return f"{amount / 1e9:.0f} GB" if amount else ""


def _count(number: int, one: str, several: str = "") -> str:
    return f"{number:,} {one if number == 1 else several or one + 's'}"


def _plain(value: object) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_plain(part)}" for name, part in value.items())
    if isinstance(value, (list, tuple)):
        return " and ".join(map(str, value))
    return str(value)
