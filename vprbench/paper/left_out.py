"""What it would take to run a row where it takes too long for a table, by its runs on a smaller dataset."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from vprbench.paper.plan import Row
from vprbench.paper.selection import Group, ResolvedColumn
from vprbench.runs.record import Run

_HOUR, _MINUTE = 3600.0, 60.0


def why_left_out(row: Row, column: ResolvedColumn, shown: Sequence[Group]) -> str:
    """Return why a row is left out of a column, and how long its seeds would take there by a run in those `shown`."""
    asking = [group for group in shown if group.asked.planned.name == column.planned.name]
    queries = next((len(run.outcome) for run in _runs(asking)), None)
    measured = next((run for run in _runs(shown, row) if run.config["device"] == "cpu" and run.fit_seconds), None)
    places = column.dataset.get("places")
    if measured is None or not isinstance(places, int):
        return "too many places for the time that a table takes; FULL=1 runs it here"
    seconds = full_seconds(measured, places, places if queries is None else queries, row.asks_its_map) * len(row.seeds)
    much = f"{seconds / _HOUR:.1f} h" if seconds > _HOUR else f"{max(1.0, seconds / _MINUTE):.0f} min"
    seeds = f"; {len(row.seeds)} seeds" if len(row.seeds) > 1 else ""
    return f"FULL=1 would take about {much} here (from its run at {measured.outcome.n_places} places{seeds})"


def full_seconds(measured: Run, places: int, queries: int, asks_its_map: bool) -> float:
    """Return the seconds of one run at so many places and queries, from one that was measured with fewer.

    Training takes as long a place, and asking as long a query and place; `asks_its_map` tells that the fit asks once
    for each of its places, too.
    """
    n_places, n_queries = measured.outcome.n_places, len(measured.outcome)
    fit = measured.fit_seconds or 0.0
    asked = max(0.0, measured.method_seconds - (measured.fit_compute_seconds or fit)) / (n_queries * n_places)
    own = places * places * asked if asks_its_map else 0.0
    training = fit - n_places * n_places * asked if asks_its_map else fit
    return max(0.0, training) * places / n_places + own + places * queries * asked


def _runs(shown: Sequence[Group], row: Row | None = None) -> Iterator[Run]:
    for group in shown:
        for run in group.runs:
            if row is None or (
                run.method == row.method and run.config.get("changed") == group.asked.planned.arguments(row)
            ):
                yield run
