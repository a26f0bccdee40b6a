"""A sweep of runs, as `-m` asks for: each is announced when it begins; one that gives no result is stored as failed."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path

from vprbench.jobs.executors import choose_executor, run_all
from vprbench.jobs.options import ClusterOptions
from vprbench.runs.request import RunRequest
from vprbench.runs.store import Store
from vprbench.terminal.live import LiveTable


def run_sweep(requests: Sequence[RunRequest], options: ClusterOptions) -> tuple[int, set[str]]:
    """Make runs and print their rows on standard output; returns the highest exit code and the keys of the runs."""
    live = LiveTable([], [], len(requests)) if options.is_distributed and sys.stderr.isatty() else None

    def begin(number: int) -> None:
        words = " ".join(requests[number].overrides)
        logging.info("run %d of the sweep: %s", number + 1, words)
        if live is not None:
            live.begin(number, words)

    codes, keys = [], set[str]()
    with choose_executor(options) as executor, live.shown() if live else nullcontext():
        for number, result in run_all(executor, enumerate(requests), begin, live.line if live else None):
            codes.append(result.code)
            keys |= {result.key} - {""}
            if result.printed:
                print(result.printed, flush=True)
            if live is not None:
                live.end(number, bool(result.code))
            if result.failure is not None:
                Store(Path(requests[number].results).expanduser()).try_to_save_failure(result.failure)
                if requests[number].output == "json":
                    names = ("method", "dataset", "error", "missing")
                    print(json.dumps({name: getattr(result.failure, name) for name in names}), flush=True)
    return max(codes, default=0), keys
