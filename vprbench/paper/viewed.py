"""Views of the stored runs that a table would show, in the place of these runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from vprbench.paper.plan import Row
from vprbench.paper.selection import DEVICES, Group, of_row
from vprbench.run.record import Failure, Run
from vprbench.run.sequences import NoScoresError, Seen, without_scores


def seen(groups: Sequence[Group], rows: Sequence[Row], views: Sequence[Seen]) -> list[Group]:
    """Return a group for each view of each group, of the runs that its rows show; without views the groups themselves.

    A run that kept no scores is a failure there, which says what to do; where no run of any group did, NoScoresError is
    raised. Of several views none keeps its scores, which may fill the memory.
    """
    if not views:
        return list(groups)
    found: list[Group] = []
    number: dict[str, int] = {}
    lacking: list[NoScoresError] = []
    for group in groups:
        chosen = {run.key: run for row in rows for device in DEVICES for run in of_row(group, row, device).runs}
        for view in views:
            shown: list[Run] = []
            failures: list[Failure] = list(group.failures)
            for run in chosen.values():
                try:
                    one = view(run)
                    shown.append(one if len(views) == 1 else replace(one, scores=None))
                except NoScoresError as error:
                    failures.append(without_scores(run, error))
                    lacking.append(error)
            number[group.asked.planned.name] = number.get(group.asked.planned.name, 0) + 1
            found.append(Group(group.asked, number[group.asked.planned.name], tuple(shown), tuple(failures)))
    if lacking and not any(group.runs for group in found):
        raise lacking[0]
    return found
