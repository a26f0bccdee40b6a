"""One run as text or JSON: its row, its notes, its views and its folder."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from vprbench.runs import energy, frame, rows, stream
from vprbench.runs.record import Run
from vprbench.runs.request import RunRequest
from vprbench.runs.sequences import parse_views
from vprbench.runs.tuned import list_notes
from vprbench.terminal.console import line_text, table_text


def format_run(
    run: Run, folder: Path | None, from_store: bool, request: RunRequest, predictions: Sequence[Path] = ()
) -> str:
    """Return the row of a run or its JSON, its notes and its views; `folder` is where it lies, None if nowhere.

    `predictions` are the files that hold the best places of each query.
    """
    seen = [view(run) for view in parse_views(request.sequence, request.filter)]
    if request.output == "json":
        return json.dumps(
            {
                "method": run.method,
                "dataset": run.dataset,
                "protocol": dict(run.protocol),
                "data": dict(run.data),
                **frame.list_numbers(run, request.metrics),
                **({"stream": stream.list_stops(run)} if request.stream else {}),
                **({"energy": run.energy} if request.energy else {}),
                "network": run.network,
                "tuned_on": run.tuned_on or None,
                "notes": [asdict(note) for note in list_notes(run)],
                **({"views": [_describe_view(one, request) for one in seen]} if seen else {}),
                **({"predictions": [*map(str, predictions)]} if predictions else {}),
                "from_store": from_store,
                "run_folder": None if folder is None else str(folder),
            },
            allow_nan=False,
        )
    shown = seen or [run]
    table = [rows.format_row(one, request.metrics) for one in shown]
    if seen:
        table = [{"answers": rows.describe_view(one), **row} for one, row in zip(seen, table, strict=True)]
    notes = [(f"note: {note.text}", "yellow", False) for note in list_notes(shown[0])]
    said: list[tuple[str, str, bool]] = [*notes, (rows.describe_protocol(run), "", True)]
    said += [(f"{rows.describe_view(one, whole=True)}: {len(one.outcome)} queries", "", False) for one in seen]
    below = [line for one in shown if (line := rows.describe_tolerance(one)) is not None]
    if from_store:
        below.append(f"from the store: {folder} (force=true runs again)")
    elif folder is not None:
        below.append(f"stored in {folder}")
    below += [f"best {request.predictions} places of each query: {file}" for file in predictions]
    tables = [table_text([*table[0]], [[*row.values()] for row in table], request.wide, rows.LEAST)]
    if request.stream:
        tables.append(stream.format_stops(run))
    if request.energy:
        tables.append(energy.format_costs(run, request.wide))
    return "\n".join([*(line_text(*each) for each in said), *tables, *map(line_text, below)])


def _describe_view(view: Run, request: RunRequest) -> dict[str, Any]:
    return {"protocol": dict(view.protocol), **frame.list_numbers(view, request.metrics)}
