"""R@1 under corruptions of the query frames, beside that on clean frames: numbers, a small table and a CSV."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from vprbench.errors import BadInput
from vprbench.metrics.intervals import difference_interval
from vprbench.report.selection import MethodRuns
from vprbench.report.table.best import average_recall
from vprbench.report.table.formats import escape_markdown
from vprbench.runs import rows
from vprbench.runs.corruption import KINDS, STRENGTHS, Corruption
from vprbench.runs.frame import iterate_rows
from vprbench.runs.recall_intervals import estimate_recall_interval, list_hits
from vprbench.runs.tuned import describe_tuning
from vprbench.text import NOTHING, format_percent


@dataclass(frozen=True)
class Robustness:
    """The points of all rows of a comparison, the clean one of each row first."""

    clean: tuple[MethodRuns, ...]
    points: pd.DataFrame  # a line for each row on clean frames, then for each corruption and row: `_measure_point`

    @property
    def kinds(self) -> dict[str, list[int]]:
        """The kinds of corruption that were run, and their strengths, ascending."""
        known = {*zip(self.points["kind"], self.points["strength"], strict=True)}
        found = {kind: [each for each in STRENGTHS if (kind, each) in known] for kind in KINDS}
        return {kind: strengths for kind, strengths in found.items() if strengths}

    @property
    def words(self) -> dict[str, str]:
        """The change of query frames by each of these kinds."""
        return {kind: KINDS[kind].describe(strengths) for kind, strengths in self.kinds.items()}

    def of(self, method: str, kind: str) -> pd.DataFrame:
        """Return the points of a row from clean to strong; a point without a run is missing."""
        return self.points[(self.points["method"] == method) & self.points["kind"].isin([kind, "clean"])]


def measure_robustness(clean: Sequence[MethodRuns], corrupted: Mapping[Corruption, Sequence[MethodRuns]]) -> Robustness:
    """Set rows under corruptions beside themselves on clean frames; a row without clean runs is left out.

    All answer the same queries. Raises BadInput if none of these has a right place.
    """
    if not clean or not clean[0].runs[0].outcome.answerable.any():
        raise BadInput("no query has a right place: there is no accuracy that a corruption could lower")
    points = [_measure_point(row, row, None) for row in clean]
    of_name = {row.name: row for row in clean}
    for one, spoilt in corrupted.items():
        points += [_measure_point(row, of_name[row.name], one) for row in spoilt if row.name in of_name]
    return Robustness(tuple(clean), pd.DataFrame(points, dtype=object))


def _measure_point(row: MethodRuns, clean: MethodRuns, one: Corruption | None) -> dict[str, Any]:
    """Return the columns of a point; shares are 0 to 1 and means over the seeds."""
    recall, interval, drop = average_recall(row.runs) or 0.0, estimate_recall_interval(row.runs), None
    if one is not None:
        ours, theirs = (np.mean([list_hits(run) for run in each.runs], axis=0) for each in (clean, row))
        drop = difference_interval(ours, theirs)
    return {
        "method": row.name,
        "kind": "clean" if one is None else one.kind,
        "strength": 0 if one is None else one.strength,
        "amount": "" if one is None else KINDS[one.kind].short([one.strength]),  # with its unit
        "seeds": len(row.runs),
        "recall_at_1": recall,
        "low": np.nan if interval is None else interval.low,  # ends of the 95 % interval
        "high": np.nan if interval is None else interval.high,
        "drop": (average_recall(clean.runs) or 0.0) - recall,  # from clean frames
        "drop_low": drop and drop.low,  # ends of the 95 % interval of the paired difference
        "drop_high": drop and drop.high,
        "tuned_on": describe_tuning(row.runs),  # remark on places that the method was tuned on; empty for none
    }


def list_lines(found: Robustness) -> list[dict[str, str]]:
    """Return the table as text: R@1 on clean frames, then for each kind the points that it costs each row.

    A drop whose interval holds 0 stands in brackets.
    """
    head = "R@1 %, less by"
    points = {(point.method, point.kind, point.strength): point for point in iterate_rows(found.points)}
    names = [row.name for row in found.clean]
    table = [{head: "clean", **{name: format_percent(points[name, "clean", 0].recall_at_1) for name in names}}]
    for kind, strengths in found.kinds.items():
        drops = {name: "/".join(_format_drop(points.get((name, kind, each))) for each in strengths) for name in names}
        table.append({head: f"{kind} {KINDS[kind].short(strengths)}", **drops})
    return table


def _format_drop(point: Any | None) -> str:
    if point is None:
        return NOTHING
    sure = point.drop_low is not None and not point.drop_low <= 0 <= point.drop_high
    return format_percent(point.drop + 0.0) if sure else f"({format_percent(point.drop + 0.0)})"


def format_markdown(found: Robustness, title: str) -> str:
    """Return the table as a document that describes each corruption."""
    effects = [f"- {kind}: queries {effect}" for kind, effect in found.words.items()]
    tuned = [f"- {escape_markdown(row.name)}: {note}" for row in found.clean if (note := describe_tuning(row.runs))]
    return "\n".join(
        [
            f"# {escape_markdown(title)}: corrupted queries\n",
            f"{rows.format_markdown(list_lines(found))}\n",
            "R@1 over all queries on clean frames, in percent; below it the points that weak, medium and strong",
            "corruptions cost. In brackets: the 95 % interval of the paired difference holds 0, or there are too few",
            "queries for one. References are clean.\n",
            *effects,
            *tuned,
            "",
        ]
    )
