"""The state of a results folder: how many runs it holds, and which are being made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from vprbench.errors import BadInput
from vprbench.plugins.options import option
from vprbench.runs.run_lock import read_claims


@dataclass(frozen=True)
class StatusOptions:
    """Where to look."""

    results: str = option("results")
    output: Literal["row", "json"] = option("row", "or json: one object")
    wide: bool = option(False, "true: all columns, however narrow the terminal")


def read_status(results: str) -> dict[str, Any]:
    """Return what a results folder holds and who works on it, as plain values; raises BadInput if there is none."""
    root = Path(results).expanduser()
    if not root.is_dir():
        raise BadInput(f"results={results} is no folder: give the folder of a run, a table or a comparison")
    stored = {f"{kind}s": len([*root.glob(f"[!.]*/[!.]*/{kind}.json")]) for kind in ("run", "failure")}
    return {"results": str(root), **stored, "claims": read_claims(root)}


def format_row(claim: Mapping[str, Any]) -> dict[str, str]:
    """Return a run that is being made as the cells of a line, by their columns."""
    words = {name: "?" if value is None else str(value) for name, value in claim.items()}
    on = "" if claim["corruption"] is None else f", {words['corruption']}"
    columns = ("host", "process", "since", "seed", "device", "owner")
    return {"run": f"{words['method']} on {words['dataset']}{on}", **{name: words[name] for name in columns}}
