"""Why a cell of the table has no number, and why a number is not the paper's: each reason has a code and a text."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from vprbench.paper.plan import PlannedColumn, Row
from vprbench.paper.selection import Device, RowRuns
from vprbench.run.record import Run

PAPER = "VPRTempo (ICRA 2024), Table II"
PAPER_CPU, PAPER_GPU = "Intel i7-9700K", "Nvidia RTX 2080"
LONGEST = 120  # letters of a reason

Mark = Literal[
    "measured",  # by this harness, on the machine that the cell names
    "quoted",  # copied from a publication: in italics, in no contest
    "not applicable",  # there is no such step: printed as -
    "not there",  # the method, its weights or the frames are missing; the row fills by itself once they are not
    "failed",
    "left out",  # too many places for this row within the time of the table
    "unfinished",  # some of the seeds are not stored yet, or none
    "not run",  # no run of this kind is stored, as on a machine without a GPU
]
Code = Literal[
    "failed",
    "missing",
    "left out",
    "seeds",  # some are not stored
    "device",  # no run on it is stored
    "protocol without runs",
    "loaded",  # a network, so nothing was trained
    "kept",  # descriptors of an earlier run, so nothing was fitted
    "undefined",
    "unpublished",  # how long a network was trained elsewhere
    "quoted",
    "rendered",
    "traverses",
    "counts",  # other places or queries than the paper's
    "tolerance",
    "distractors",
    "no distractors",
    "size",
    "hardware",
    "boundary",
    "paper's way",  # of timing, as the row's remark says
    "timing",
    "both steps",
    "map",
    "tuned",
    "ties",
    "note",  # of a run
]
#: The word of a cell without a number, by the reason.
MARKS: Mapping[Code, Mark] = {
    **{"failed": "failed", "missing": "not there", "left out": "left out", "seeds": "unfinished"},
    **dict.fromkeys(("device", "protocol without runs", "loaded", "kept"), "not run"),
}


class Reason(NamedTuple):
    """What a note below the table says, and what kind of reason it is."""

    code: Code
    text: str


@dataclass(frozen=True)
class _Protocol:
    """What the paper says of one of its datasets; no tolerance in either."""

    places: int
    queries: int
    references: frozenset[str]
    query: str


_PAPER = {
    "Nordland": _Protocol(3300, 2700, frozenset({"spring", "fall"}), "summer"),
    "Oxford RobotCar": _Protocol(450, 360, frozenset({"sun", "rain"}), "dusk"),
}


def short(code: Code, text: str) -> Reason:
    """Return a reason cut to the length of a note."""
    return Reason(code, one_sentence(text, sentences=False))


def one_sentence(text: str, sentences: bool = True) -> str:
    """Return the first sentence of a message, cut between words where it is long, without its full stop."""
    line = " ".join(text.split())
    if sentences:
        line = re.split(r"(?<=[.!?;]) ", line, maxsplit=1)[0]
    line = line.rstrip(" .;")
    if len(line) <= LONGEST:
        return line
    cut = line[: LONGEST - 1]
    return (cut[: cut.rfind(" ")] if cut.rfind(" ") > LONGEST // 2 else cut).rstrip(" ,;:") + "…"


# No number


def absent(row: Row, device: Device, found: RowRuns, elsewhere: bool, left_out: str | None) -> Reason:
    """Return why a row without runs on a kind of device has none.

    `elsewhere` tells whether the other kind of device has runs. `left_out` says where rows stand that take too long: on
    the CPU, for of a GPU no more is known than that nothing is stored.
    """
    if found.failures:
        first = next((failure for failure in found.failures if not failure.missing), found.failures[0])
        return Reason("missing" if first.missing else "failed", one_sentence(first.error))
    if left_out is not None and device == "cpu" and not elsewhere:
        return Reason("left out", left_out)
    if device == "cuda" or elsewhere:
        return Reason("device", f"no run of this row on a {'CPU' if device == 'cpu' else 'GPU'} is stored")
    return stored_seeds(row, found)


def stored_seeds(row: Row, found: RowRuns) -> Reason:
    """Return how many of a row's seeds are stored, and which failed."""
    text = f"{len(found.runs)} of {len(row.seeds)} seed{'s are' if len(row.seeds) > 1 else ' is'} stored"
    missing = [failure for failure in found.failures if failure.config["seed"] in found.missing_seeds]
    failed = (f"seed {failure.config['seed']} failed: {failure.error}" for failure in missing)
    return short("seeds", "; ".join([text, *failed]))


# Another number than the paper's, the weightiest reason first


def of_accuracy(planned: PlannedColumn, real_title: str | None, run: Run) -> Iterator[Reason]:
    """Yield why an accuracy and the published one cannot be compared; nothing for a column that the paper lacks.

    `real_title` names the dataset that a rendered one stands in for. `run` is one of the cell's; all of them share what
    is looked at here.
    """
    paper = _PAPER.get(planned.published or "")
    if paper is None:
        return
    found = [*_data(real_title, run, paper), *_protocol(run, paper)]
    n_places, n_queries = run.outcome.n_places, len(run.outcome)
    yield from found
    said = "places that are not queried; the paper does not say whether its map does"
    if not found and n_places > n_queries:
        yield short("distractors", f"our map keeps the {n_places - n_queries:,} {said}")
    elif not found and _leaves_out(run, paper):
        yield short("no distractors", f"our map leaves out {paper.places - n_places:,} {said}")


def of_times(planned: PlannedColumn, real_title: str | None, run: Run, device: Device) -> Iterator[Reason]:
    """Yield why a time on a kind of device and the published one cannot be compared, as `of_accuracy` does."""
    paper = _PAPER.get(planned.published or "")
    if paper is None:
        return
    yield from _data(real_title, run, paper)
    if run.outcome.n_places != paper.places:
        yield short("size", f"other size: {run.outcome.n_places:,} places; the paper's: {paper.places:,}")
    name, theirs = ("processor", PAPER_CPU) if device == "cpu" else ("accelerator", PAPER_GPU)
    ours = str(run.environment.get(name, "an unknown GPU"))
    if theirs.split()[-1] not in ours:
        yield short("hardware", f"other hardware: {ours}; the paper's: {theirs}")


def of_rates(row: Row, planned: PlannedColumn) -> Iterator[Reason]:
    """Yield which step a rate covers, and what is known of how the paper timed the row."""
    if planned.published in _PAPER and row.boundary is not None:
        step = "feature extraction" if row.boundary == "encode" else "matching"
        yield Reason("boundary", f"the rate covers {step} alone, here and in the paper")
    if planned.published in _PAPER and row.rate_remark is not None:
        yield short("paper's way", row.rate_remark)


def other_timing(runs: Mapping[str, Run]) -> dict[str, Reason]:
    """Return what to say of the rates of rows that were timed under another protocol than most rows of their column.

    `runs` holds one run of each row, for all of a row share their protocol. Of equally many, the first row's counts.
    """
    ways: list[tuple[Any, list[str]]] = []
    for name, run in runs.items():
        asked = run.config.get("timing")
        alike = next((names for known, names in ways if known == asked), None)
        if alike is None:
            ways.append((asked, [name]))
        else:
            alike.append(name)
    ways.sort(key=lambda way: -len(way[1]))
    return {name: _timed(asked, *ways[0]) for asked, names in ways[1:] for name in names}


def _timed(asked: Mapping[str, Any] | None, usual: Mapping[str, Any] | None, others: Sequence[str]) -> Reason:
    if asked is None:
        return Reason("timing", "timed under a protocol that its older record does not hold")
    differing = [name for name in asked if usual is None or asked[name] != usual.get(name)]
    if {"minimum_seconds", "minimum_queries"}.isdisjoint(differing):
        what = ", ".join(f"{name.replace('_', ' ')} {asked[name]}" for name in differing)
    else:
        queries = asked["minimum_queries"]
        what = f"at least {asked['minimum_seconds']:g} s and {queries} {'query' if queries == 1 else 'queries'}"
    whose = " and ".join(others) if len(others) < 3 else "most rows"
    return short("timing", f"timed under another protocol than {whose}: {what}")


def _data(real_title: str | None, run: Run, paper: _Protocol) -> Iterator[Reason]:
    if real_title is not None:
        yield short("rendered", f"other data: rendered frames stand in for {real_title}")
        return
    references, query = run.protocol.get("references"), run.protocol.get("query")
    if references is not None and (frozenset(references), query) != (paper.references, paper.query):
        theirs = f"{' and '.join(sorted(paper.references, reverse=True))} against {paper.query}"
        ours = f"{' and '.join(references)} against {query}"
        yield short("traverses", f"other traverses: {ours}; the paper's: {theirs}")


def _protocol(run: Run, paper: _Protocol) -> Iterator[Reason]:
    places, queries = run.outcome.n_places, len(run.outcome)
    if (places, queries) != (paper.places, paper.queries) and not _leaves_out(run, paper):
        theirs = f"{paper.queries:,} of {paper.places:,}"
        yield short("counts", f"other protocol: {queries:,} queries of {places:,} places; the paper's: {theirs}")
    for name, unit in (("tolerance_places", "place"), ("tolerance_metres", "m"), ("radius_metres", "m")):
        if within := run.protocol.get(name):
            words = f"{within:g} {unit}{'s' if unit == 'place' and within > 1 else ''}"
            yield short("tolerance", f"other protocol: right within {words}; the paper's: the same place alone")


def _leaves_out(run: Run, paper: _Protocol) -> bool:
    """Tell whether a run asked the paper's queries of their own places alone, as VPRSNN's authors do."""
    asked_alone = run.outcome.n_places == len(run.outcome) == paper.queries
    return asked_alone and run.protocol.get("protocol") == "vprsnn"
