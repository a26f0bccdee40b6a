"""Why a measured number and the one that the paper printed are not the same thing: short reasons for each cell."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from vprbench.paper.plan import PlannedColumn, Quantity, Row
from vprbench.paper.table.absence import one_sentence
from vprbench.run.record import Run

PAPER = "VPRTempo (ICRA 2024), Table II"
PAPER_CPU, PAPER_GPU = "Intel i7-9700K", "Nvidia RTX 2080"

_RENDERED = "other data: rendered frames stand in for {}"
_HARDWARE = "other hardware: {}; the paper's: {}"
_BOUNDARIES = {
    "encode": "the rate covers feature extraction alone, here and in the paper",
    "match": "the rate covers matching alone, here and in the paper",
}
_DISTRACTORS = "our map keeps the {:,} places that are not queried; the paper does not say whether its map does"
_NO_DISTRACTORS = "our map leaves out {:,} places that are not queried; the paper does not say whether its map does"
_LOOP = "the paper's rate looks like a loop over the references; ours compares all at once"


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


def reasons(row: Row, planned: PlannedColumn, real_title: str | None, quantity: Quantity, run: Run) -> list[str]:
    """Return why a row's number and the published one cannot be compared, the weightiest first.

    `real_title` names the dataset that a rendered one stands in for. `run` is one of the cell's; all of them share what
    is looked at here. Nothing is returned for a column that the paper does not have.
    """
    paper = _PAPER.get(planned.published or "")
    if paper is None:
        return []
    found = [*_data(real_title, run, paper)]
    if quantity == "recall_at_1":
        found += _protocol(run, paper)
        if not found and run.outcome.n_places > len(run.outcome):
            found.append(_DISTRACTORS.format(run.outcome.n_places - len(run.outcome)))
        elif not found and _leaves_out(run, paper):
            found.append(_NO_DISTRACTORS.format(paper.places - run.outcome.n_places))
    else:
        if run.outcome.n_places != paper.places:
            found.append(f"other size: {run.outcome.n_places:,} places; the paper's: {paper.places:,}")
        found += _hardware(quantity, run)
        if quantity in ("query_cpu", "query_gpu"):
            found += _rate(row)
    return [one_sentence(reason, sentences=False) for reason in found]


def other_timing(runs: Mapping[str, Run]) -> dict[str, str]:
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


def _timed(asked: Mapping[str, Any] | None, usual: Mapping[str, Any] | None, others: Sequence[str]) -> str:
    if asked is None:
        return "timed under a protocol that its older record does not hold"
    differing = [name for name in asked if usual is None or asked[name] != usual.get(name)]
    if {"minimum_seconds", "minimum_queries"}.isdisjoint(differing):
        what = ", ".join(f"{name.replace('_', ' ')} {asked[name]}" for name in differing)
    else:
        queries = asked["minimum_queries"]
        what = f"at least {asked['minimum_seconds']:g} s and {queries} {'query' if queries == 1 else 'queries'}"
    whose = " and ".join(others) if len(others) < 3 else "most rows"
    return one_sentence(f"timed under another protocol than {whose}: {what}", sentences=False)


def _data(real_title: str | None, run: Run, paper: _Protocol) -> Iterator[str]:
    if real_title is not None:
        yield _RENDERED.format(real_title)
        return
    references, query = run.protocol.get("references"), run.protocol.get("query")
    if references is not None and (frozenset(references), query) != (paper.references, paper.query):
        theirs = f"{' and '.join(sorted(paper.references, reverse=True))} against {paper.query}"
        yield f"other traverses: {' and '.join(references)} against {query}; the paper's: {theirs}"


def _protocol(run: Run, paper: _Protocol) -> Iterator[str]:
    places, queries = run.outcome.n_places, len(run.outcome)
    if (places, queries) != (paper.places, paper.queries) and not _leaves_out(run, paper):
        yield (
            f"other protocol: {queries:,} queries of {places:,} places; "
            f"the paper's: {paper.queries:,} of {paper.places:,}"
        )
    for name, unit in (("tolerance_places", "place"), ("tolerance_metres", "m"), ("radius_metres", "m")):
        if within := run.protocol.get(name):
            words = f"{within:g} {unit}{'s' if unit == 'place' and within > 1 else ''}"
            yield f"other protocol: right within {words}; the paper's: the same place alone"


def _leaves_out(run: Run, paper: _Protocol) -> bool:
    """Tell whether a run asked the paper's queries of their own places alone, as VPRSNN's authors do."""
    asked_alone = run.outcome.n_places == len(run.outcome) == paper.queries
    return asked_alone and run.protocol.get("protocol") == "vprsnn"


def _hardware(quantity: Quantity, run: Run) -> Iterator[str]:
    ours, theirs = str(run.environment["processor"]), PAPER_CPU
    if quantity in ("train_gpu", "query_gpu"):
        ours, theirs = str(run.environment.get("accelerator", "an unknown GPU")), PAPER_GPU
    if theirs.split()[-1] not in ours:
        yield _HARDWARE.format(ours, theirs)


def _rate(row: Row) -> Iterator[str]:
    if row.boundary is not None:
        yield _BOUNDARIES[row.boundary]
    if row.name == "SAD":
        yield _LOOP
