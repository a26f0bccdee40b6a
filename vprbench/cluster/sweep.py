"""A sweep of runs, as `-m` asks for: made by a crew, each run told when it begins, and stored if it is lost."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from contextlib import nullcontext

from vprbench.cluster.crew import crew, results_of
from vprbench.cluster.options import ClusterOptions
from vprbench.errors import BadInput
from vprbench.plugins import registry
from vprbench.plugins.options import chosen
from vprbench.progress import marked
from vprbench.run import machine
from vprbench.run.compose import composed
from vprbench.run.processes import Ending, record
from vprbench.run.record import Failure
from vprbench.run.settings import RECORDED
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
    making = crew(options, stdout=None)
    live = LiveTable([], [], len(runs)) if making.elsewhere and sys.stderr.isatty() else None

    def begins(number: int, host: str) -> None:
        where = f" on {host}" if making.elsewhere else ""
        logger.info("run %d of the sweep%s: %s", number + 1, where, " ".join(runs[number]))
        if live is not None:
            live.begin(number, " ".join(runs[number]), host)

    def heard(number: int, line: str) -> None:
        told = marked(line)
        if live is not None and isinstance(told, tuple):
            live.share(number, f"{told[0].split(',')[0]} {100 * told[1]:.0f} %", 0.0)
        elif live is not None and not isinstance(told, tuple):
            live.line(told or line)

    codes = []
    with making, live or nullcontext():
        for number, ending in making.endings(enumerate(runs), begins, heard if live else None):
            codes.append(ending.code)
            if live is not None:
                live.step(number, bool(ending.code))
            if ending.code == 1 and not ending.recorded:
                record(lost(runs[number], ending), results_of(runs[number]))
    return max(codes, default=0)


def lost(options: Sequence[str], ending: Ending) -> Failure:
    """Return the failure of a run whose process could not store it, under the key that the run itself has."""
    config = composed(options)
    name = next((option.partition("=")[2] for option in options if option.startswith("method=")), "sad")
    asked = {each: config[each] for each in RECORDED} | {"overrides": list(map(registry.as_asked, options))}
    asked["method"] = registry.declared(name, asked["method"])[0]
    dataset = str(asked["dataset"].get("name", "dataset"))
    return Failure(name, dataset, asked, ending.error, machine.capture("cpu", 1), ending.missing)
