"""One run as text or JSON: its row, its notes, its views and its folder."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from vprbench.runs import energy, frame, rows, stream
from vprbench.runs.record import Run
from vprbench.runs.request import RunRequest
from vprbench.runs.tuned import list_notes
from vprbench.terminal.console import format_line, format_table


def format_run(
    run: Run, folder: Path | None, from_store: bool, request: RunRequest, predictions: Sequence[Path] = ()
) -> str:
    """Return the row of a run or its JSON, its notes and its views; `folder` is where it lies, None if nowhere.

    `predictions` are the files that hold the best places of each query.
    """
    views = [view(run) for view in request.list_views()]
    if request.output == "json":
        return _format_json(run, views, folder, from_store, request, predictions)
    shown = views or [run]
    table = [rows.format_row(one, request.metrics) for one in shown]
    if views:
        table = [{"answers": rows.describe_sequence(view), **row} for view, row in zip(views, table, strict=True)]
    lines = [format_line(f"note: {note.text}", "yellow") for note in list_notes(shown[0])]
    lines.append(format_line(rows.describe_protocol(run), fits=True))
    total = len(run.outcome)
    lines += [format_line(f"{rows.describe_sequence(view)}: {len(view.outcome)} of {total} queries") for view in views]
    lines.append(format_table([*table[0]], [[*row.values()] for row in table], request.wide, rows.LEAST))
    if request.stream:
        lines.append(stream.format_stops(run))
    if request.energy:
        lines.append(energy.format_costs(run, request.wide))
    lines += [format_line(text) for one in shown if (text := rows.describe_wider_recall(one)) is not None]
    if from_store:
        lines.append(format_line(f"from the store: {folder} (force=true runs again)"))
    elif folder is not None:
        lines.append(format_line(f"stored in {folder}"))
    lines += [format_line(f"best {request.predictions} places of each query: {file}") for file in predictions]
    return "\n".join(lines)


def _format_json(
    run: Run, views: Sequence[Run], folder: Path | None, from_store: bool, request: RunRequest, files: Sequence[Path]
) -> str:
    facts = {
        "method": run.method,
        "dataset": run.dataset,
        "protocol": dict(run.protocol),
        "data": dict(run.data),
        **frame.list_numbers(run, request.metrics),
        **({"stream": run.stream} if request.stream else {}),
        **({"energy": run.energy} if request.energy else {}),
        "network": run.network,
        "tuned_on": run.tuned_on or None,
        "notes": [asdict(note) for note in list_notes(run)],
    }
    if views:
        facts["views"] = [
            {"protocol": dict(view.protocol), **frame.list_numbers(view, request.metrics)} for view in views
        ]
    if files:
        facts["predictions"] = [*map(str, files)]
    place = None if folder is None else str(folder)
    return json.dumps({**facts, "from_store": from_store, "run_folder": place}, allow_nan=False)
