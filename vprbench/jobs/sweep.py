"""A sweep of runs, as `-m` asks for: each run is told when it begins, and stored as failed if its process dies."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Sequence
from contextlib import nullcontext

from vprbench.errors import BadInput
from vprbench.jobs.child import results_of
from vprbench.jobs.executors import Callbacks, executor_for, run_all
from vprbench.jobs.job import JobResult
from vprbench.jobs.options import ClusterOptions
from vprbench.plugins import registry
from vprbench.plugins.options import chosen
from vprbench.runs import machine
from vprbench.runs.compose import composed
from vprbench.runs.record import Failure
from vprbench.runs.settings import RECORDED
from vprbench.runs.store import Store
from vprbench.terminal.live import LiveTable

logger = logging.getLogger(__name__)


def divided(arguments: Sequence[str], sweep: bool) -> tuple[ClusterOptions, list[str]]:
    """Return where the runs of a command line are made, and their own options; raises BadInput for a single run."""
    own = [argument for argument in arguments if ClusterOptions.has(argument)]
    if own and not sweep:
        raise BadInput(f"{own[0]}: a single run is made here: give -m for several, or compare, table, figures, report")
    options = chosen(ClusterOptions, own, {})
    rest = [argument for argument in arguments if argument not in own]
    return options, [*rest, *options.threads(rest)]


def swept(runs: Sequence[Sequence[str]], options: ClusterOptions) -> int:
    """Make runs of the command line, whose answers go to standard output; returns the highest exit code."""
    executor = executor_for(options)
    live = LiveTable([], [], len(runs)) if executor.is_distributed and sys.stderr.isatty() else None

    def begins(number: int, host: str) -> None:
        where = f" on {host}" if executor.is_distributed else ""
        logger.info("run %d of the sweep%s: %s", number + 1, where, " ".join(runs[number]))
        if live is not None:
            live.begin(number, " ".join(runs[number]), host)

    def heard(number: int, line: str) -> None:
        if live is not None:
            live.line(line)

    codes = []
    with executor, live or nullcontext():
        for number, result in run_all(executor, enumerate(runs), Callbacks(begins, heard if live else None)):
            codes.append(result.code)
            if result.printed:
                print(result.printed, flush=True)
            if live is not None:
                live.end(number, bool(result.code))
            if result.code == 1 and not result.recorded:
                failure = lost(runs[number], result)
                Store(results_of(runs[number])).try_to_save_failure(failure)
                if "output=json" in runs[number]:
                    print(as_json(failure), flush=True)
    return max(codes, default=0)


def as_json(failure: Failure) -> str:
    """Return what a reader of JSON is told of a failure."""
    return json.dumps({name: getattr(failure, name) for name in ("method", "dataset", "error", "missing")})


def lost(options: Sequence[str], result: JobResult) -> Failure:
    """Return the failure of a run whose process could not store it, under the key that the run itself has."""
    config = composed(options)
    name = next((option.partition("=")[2] for option in options if option.startswith("method=")), "sad")
    asked = {each: config[each] for each in RECORDED} | {"overrides": list(map(registry.with_plugin_paths, options))}
    asked["method"] = registry.declared(name, asked["method"])[0]
    dataset = str(asked["dataset"].get("name", "dataset"))
    return Failure(name, dataset, asked, result.error, machine.describe_machine("cpu", 1), result.missing)
