"""What goes on in a results folder: which runs are made now, by whom and how far, and how many are stored."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from vprbench.errors import BadInput
from vprbench.runs.run_lock import HeldLock, held_locks

_ABOUT = ("method", "dataset", "seed", "device", "corruption")
_STORED = {"runs": "*/[!.]*/run.json", "failures": "*/[!.]*/failure.json"}


@dataclass(frozen=True)
class StatusOptions:
    """Where to look."""

    results: str = "results"  # folder of the stored runs
    output: Literal["row", "json"] = "row"  # or json: one object
    wide: bool = False  # true: all columns, however narrow the terminal


def status(results: str) -> dict[str, Any]:
    """Return what a results folder holds and who works on it, as plain values; raises BadInput if there is none."""
    root = Path(results).expanduser()
    if not root.is_dir():
        raise BadInput(f"results={results} is no folder: give the folder of a run, a table or a comparison")
    stored = {
        kind: sum(not path.parent.parent.name.startswith(".") for path in root.glob(pattern))
        for kind, pattern in _STORED.items()
    }
    claims = sorted(map(_claim, held_locks(root)), key=lambda claim: str(claim["since"]))
    return {"results": str(root), **stored, "claims": claims}


def _claim(held: HeldLock) -> dict[str, Any]:
    """Return a run that is being made as plain values, None for what the file of its lock does not tell."""
    about, since, done = (held.words.get(name) for name in ("about", "since", "done"))
    told = about if isinstance(about, Mapping) else {}
    return {
        **{name: told.get(name) for name in _ABOUT},
        **{name: held.words.get(name) for name in ("owner", "host", "process")},
        "since": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(since)) if isinstance(since, float) else None,
        "stage": held.words.get("stage"),
        "done": done if isinstance(done, float) else None,
        "silent_seconds": round(held.silent_seconds, 1),
        "alive": True,
    }


def row(claim: Mapping[str, Any]) -> dict[str, str]:
    """Return a run that is being made as the cells of a line, by their columns."""
    words = {name: "?" if value is None else str(value) for name, value in claim.items()}
    on = "" if claim["corruption"] is None else f", {words['corruption']}"
    return {
        "run": f"{words['method']} on {words['dataset']}{on}",
        "stage": words["stage"].split(",")[0],
        "%": "?" if claim["done"] is None else f"{100 * claim['done']:.0f}",
        "host": words["host"],
        "process": words["process"],
        "last word": f"{claim['silent_seconds']:.0f} s ago",
        "seed": words["seed"],
        "device": words["device"],
        "owner": words["owner"],
        "since": words["since"],
    }
