"""Views of the stored runs that a table would show, in the place of these runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from vprbench.paper.plan import Row
from vprbench.paper.selection import DEVICES, Group, of_row
from vprbench.runs.record import Failure, Run
from vprbench.runs.sequences import NoScoresError, Views, suffix


def seen(groups: Sequence[Group], rows: Sequence[Row], views: Sequence[Views]) -> list[Group]:
    """Return a group for each view of each group, of the runs that its rows show; without views the groups themselves.

    A run that kept no scores is a failure there, which says what to do; where no run of any group did, NoScoresError is
    raised. Of several views none keeps its scores, which may fill the memory.
    """
    if not views:
        return list(groups)
    found: list[Group] = []
    lacking: list[NoScoresError] = []
    for group in groups:
        chosen = {run.key: run for row in rows for device in DEVICES for run in of_row(group, row, device).runs}
        of_views: list[Group] = []
        for view in views:
            shown: list[Run] = []
            failures = list(group.failures)
            for run in chosen.values():
                try:
                    one = view(run)
                    shown.append(one if len(views) == 1 else replace(one, scores=None))
                except NoScoresError as error:
                    failures.append(Failure(run.method, run.dataset, run.config, str(error), run.environment, True))
                    lacking.append(error)
            of_views.append(replace(group, runs=tuple(shown), failures=tuple(failures), view=suffix([view])[1:]))
        found += [one for one in of_views if one.runs] or [replace(of_views[0], view="")]
    if lacking and not any(group.runs for group in found):
        raise lacking[0]
    return found
