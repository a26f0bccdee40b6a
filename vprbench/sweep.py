"""Runs in processes of their own, so that nothing of one can reach the next: sweeps and the rows of the table."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import yaml

import vprbench
from vprbench import registry, tables
from vprbench.records import Failure, Run, load, replace_text

IN_SWEEP = "VPRBENCH_IN_SWEEP"  # set for the runs of a sweep: they record even a failure that is the user's


def run_apart(overrides: Sequence[str], stdout: int | None = None) -> subprocess.CompletedProcess[str]:
    """Run one configuration with the command line of a new process."""
    home = str(Path(vprbench.__file__).resolve().parents[1])
    path = os.pathsep.join(filter(None, [home, os.environ.get("PYTHONPATH")]))
    return subprocess.run(
        [sys.executable, "-m", "vprbench", *overrides],
        env={**os.environ, IN_SWEEP: "1", "PYTHONPATH": path},
        stdout=stdout,
        text=True,
        check=False,
    )


def make_table(options: Sequence[str], results: Path) -> int:
    """Run the rows of conf/table.yaml, print the table and write it to `results`; returns the exit code."""
    rows = yaml.safe_load((registry.conf_folders()["vprbench"] / "table.yaml").read_text(encoding="utf-8"))["rows"]
    outcomes, codes = zip(*(_table_cell(row, [*options, "output=json"]) for row in rows), strict=True)
    if set(codes) == {2}:
        return 2  # what no row can run with is no result, and the old table stays
    text = tables.table_text(outcomes)
    results.mkdir(parents=True, exist_ok=True)
    for name, content in (("table.md", text), ("table.csv", tables.csv(outcomes))):
        replace_text(results / name, content)
    print(text, end="")
    print(f"\nwritten to {results / 'table.md'} and {results / 'table.csv'}")
    return 1 if any(isinstance(outcome, Failure) for outcome in outcomes) else 0


def _table_cell(row: Sequence[str], options: Sequence[str]) -> tuple[Run | Failure, int]:
    """Run one row of the table, or find it in the store, and return it with the exit code; a failure is a row too."""
    child = run_apart([*row, *options], stdout=subprocess.PIPE)
    answer = json.loads(child.stdout) if child.stdout.strip().startswith("{") else {}
    if child.returncode == 0:
        run = load(Path(answer["run_folder"]))
        return dataclasses.replace(run, config={**run.config, "overrides": list(row)}), 0
    name = next(option.split("=", 1)[1] for option in row if option.startswith("method="))
    ending = f"ended by signal {-child.returncode}" if child.returncode < 0 else "the message is above"
    error = answer.get("error", ending)
    return Failure(name, answer.get("dataset", ""), {"overrides": list(row)}, error), child.returncode
