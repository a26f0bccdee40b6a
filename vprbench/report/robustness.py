"""R@1 under corruptions of the query frames, beside that on clean frames: numbers, a small table and a CSV."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from vprbench.errors import BadInput
from vprbench.metrics.accuracy import hits_at
from vprbench.metrics.catalogue import METRICS
from vprbench.metrics.intervals import Values, difference_interval
from vprbench.report.selection import Series
from vprbench.report.table.best import average_recall
from vprbench.report.table.formats import escape_markdown
from vprbench.runs import rows
from vprbench.runs.corruption import KINDS, STRENGTHS, Corruption
from vprbench.runs.frame import iterate_rows
from vprbench.runs.recall_intervals import order_along_journey, recall_interval
from vprbench.runs.record import Run
from vprbench.runs.tuned import describe_tuning

_ABSENT = "-"


#: The columns of the points; shares are 0 to 1 and means over the seeds.
COLUMNS = (
    *("method", "kind", "strength"),  # the row's name; "clean" of strength 0
    "amount",  # with its unit; empty on clean frames
    *("seeds", "recall_at_1", "low", "high"),  # with its 95 % interval
    *("drop", "drop_low", "drop_high"),  # from clean frames, with the 95 % interval of the paired difference
    "tuned_on",  # remark on places that the method was tuned on; empty for none
)


@dataclass(frozen=True)
class Robustness:
    """The points of all rows of a comparison, the clean one of each row first."""

    clean: tuple[Series, ...]
    points: pd.DataFrame  # a line for each row on clean frames, then for each corruption and row: `COLUMNS`

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


def measure_robustness(clean: Sequence[Series], corrupted: Mapping[Corruption, Sequence[Series]]) -> Robustness:
    """Set rows under corruptions beside themselves on clean frames; a row without clean runs is left out.

    All answer the same queries. Raises BadInput if none of these has a right place.
    """
    if not clean or not clean[0].runs[0].outcome.answerable.any():
        raise BadInput("no query has a right place: there is no accuracy that a corruption could lower")
    points = [_point(row, row, None) for row in clean]
    of_name = {row.name: row for row in clean}
    for one, spoilt in corrupted.items():
        points += [_point(row, of_name[row.name], one) for row in spoilt if row.name in of_name]
    return Robustness(tuple(clean), pd.DataFrame(points, columns=[*COLUMNS], dtype=object))


def _point(row: Series, clean: Series, one: Corruption | None) -> dict[str, Any]:
    recall, before, interval = average_recall(row.runs), average_recall(clean.runs), recall_interval(row.runs)
    assert recall is not None
    assert before is not None
    assert interval is not None
    order = order_along_journey(clean.runs[0])
    drop = None if one is None else difference_interval(_hits(clean.runs)[order], _hits(row.runs)[order])
    of_corruption = ("clean", 0, "") if one is None else (one.kind, one.strength, KINDS[one.kind].short([one.strength]))
    accuracy = (len(row.runs), recall, interval.low, interval.high)
    ends = (None, None) if drop is None else (drop.low, drop.high)
    values = (row.name, *of_corruption, *accuracy, before - recall, *ends, describe_tuning(row.runs))
    return dict(zip(COLUMNS, values, strict=True))


def _hits(runs: Sequence[Run]) -> Values:
    return np.asarray(np.mean([hits_at(run.outcome, 1) for run in runs], axis=0))


def list_lines(found: Robustness) -> list[dict[str, str]]:
    """Return the table as text: R@1 on clean frames, then for each kind the points that it costs each row.

    A drop whose interval holds 0 stands in brackets.
    """
    head = "R@1 %, less by"
    table = [{head: "clean"}]
    for point in iterate_rows(found.points[found.points["strength"] == 0]):
        table[0][point.method] = _percent(point.recall_at_1)
    for kind, strengths in found.kinds.items():
        table.append({head: f"{kind} {KINDS[kind].short(strengths)}"})
        for row in found.clean:
            there = {point.strength: point for point in iterate_rows(found.of(row.name, kind))}
            table[-1][row.name] = "/".join(_drop(there.get(each)) for each in strengths)
    return table


def _drop(point: Any | None) -> str:
    if point is None:
        return _ABSENT
    sure = point.drop_low is not None and point.drop_high is not None and not point.drop_low <= 0 <= point.drop_high
    return _percent(point.drop) if sure else f"({_percent(point.drop)})"


def _percent(share: float) -> str:
    return METRICS["recall_at_1"].text(share + 0.0)


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


def format_csv(found: Robustness) -> str:
    """Return a line for each row and corruption, unrounded."""
    return str(found.points.to_csv(index=False, lineterminator="\n"))
