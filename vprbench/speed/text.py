"""The benchmark of speed for people: its report as Markdown, and as JSON with every lap."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from vprbench.metrics.growth import exponent
from vprbench.paper.plan import PAPER, PAPER_CPU, published
from vprbench.run.document import document
from vprbench.run.machine import machine_lines
from vprbench.speed.cells import AskingCell, ModuleCell, Report, ScalingCell
from vprbench.speed.format import figures, publish, ratio, size
from vprbench.speed.measure import median
from vprbench.speed.rows import fit_seconds, tables
from vprbench.speed.settings import FRAME, RULES, TRAVERSES, VPRSNN

_TEMPLATE = Path(__file__).with_name("bench.md.j2")
_NOISE = 0.05  # drift of a fixed computation that marks a section as noisy
_LARGE = 1000  # places from which on the growth is looked at apart: there are about as many modules as places ask for


def write(report: Report, results: Path) -> None:
    """Print the report as Markdown, and leave it with all laps in bench.md and bench.json of the folder `results`."""
    publish(results, bench_md=text_of(report), bench_json=json.dumps(asdict(report), allow_nan=False))


def text_of(report: Report) -> str:
    """Return a report as Markdown."""
    start, here = report.canary_seconds["start"], report.environment
    drifts = {name: seconds / start for name, seconds in report.canary_seconds.items() if name != "start"}
    pressures = (here["cpu_pressure_avg10"], report.cpu_pressure_avg10_after)
    loads = (here["load_average"], report.load_average_after)
    return document(
        _TEMPLATE,
        report=report,
        settings=report.settings,
        tables=tables(report),
        growth={"rows": _growth_rows(report), "claims": _claims(report)},
        vprsnn=_beside_the_paper(report),
        noisy=[f"{name} {drift:.2f}" for name, drift in drifts.items() if abs(drift - 1) > _NOISE],
        drifts=[f"{name} {drift:.2f}" for name, drift in drifts.items()],
        machine=machine_lines(here),
        loads=[", ".join(f"{load:.2f}" for load in each) for each in loads],
        pressures=["unknown" if share is None else f"{share:.0f} %" for share in pressures],
        size=size,
        number="{:,}".format,
        **{"FRAME": FRAME, "TRAVERSES": TRAVERSES, "PAPER": PAPER, "PAPER_CPU": PAPER_CPU},
    )


_TIMES: dict[str, Callable[[ScalingCell], float]] = {
    "fit": fit_seconds,
    "query, streaming": lambda cell: 1 / cell.rates.streaming.total,
    "query, offline": lambda cell: 1 / cell.rates.offline.total,
}


def _measured(report: Report, rules: str, least: int = 0) -> list[ScalingCell]:
    cells = [cell for cell in report.scaling if isinstance(cell, ScalingCell)]
    return [cell for cell in cells if cell.rules == rules and cell.places >= least]


def _growth_rows(report: Report) -> list[dict[str, str]]:
    return [
        {
            "rules": rules,
            "time": time,
            "b, all sizes": grown(_measured(report, rules), seconds),
            f"b, from {_LARGE:,} places": grown(_measured(report, rules, _LARGE), seconds),
        }
        for rules in RULES
        for time, seconds in _TIMES.items()
    ]


def grown(cells: Sequence[ScalingCell], seconds: Callable[[ScalingCell], float]) -> str:
    """Return the exponent by which a time grows over sizes, with its interval."""
    if len(cells) < 2:
        return f"{len(cells)} sizes: needs two"
    found = exponent([cell.places for cell in cells], [seconds(cell) for cell in cells])
    if math.isinf(found.high):
        return f"{found.value:.2f} (2 sizes, no interval)"
    return f"{found.value:.2f} [{found.low:.2f}, {found.high:.2f}] ({len(cells)} sizes)"


def _claims(report: Report) -> dict[str, list[str]]:
    """Return for fits and for queries how their times grow from the smallest size to the largest, by rules."""
    claims: dict[str, list[str]] = {"fits": [], "queries": []}
    for rules in RULES:
        cells = _measured(report, rules)
        if len(cells) < 2 or cells[0].places < 2:
            continue
        first, last = cells[0], cells[-1]
        fit, *queries = (
            f"{time}: {ratio(seconds(last), seconds(first))}, as n^{grown(cells, seconds)}"
            for time, seconds in _TIMES.items()
        )
        for name, found in (("fits", fit), ("queries", ", ".join(queries))):
            claims[name].append(
                f"{rules} rules, from {first.places:,} to {last.places:,} places (n grows "
                f"{ratio(last.places, first.places)}, log n {ratio(math.log(last.places), math.log(first.places))}): "
                f"{found}"
            )
    return claims


def _beside_the_paper(report: Report) -> dict[str, Any]:
    """Return what was measured of VPRSNN beside what the paper printed; queries are those to the most modules."""
    asked = [cell for cell in report.vprsnn_queries if isinstance(cell, AskingCell)]
    most = max((cell.modules for cell in asked), default=0)
    return {
        "printed": published()["VPRSNN", "Nordland"],
        "trained": [
            f"{cell.method} {figures(fit_seconds(cell))} s"
            for cell in report.vprsnn_training
            if isinstance(cell, ModuleCell)
        ],
        "most": most,
        "asked": [
            f"{figures(1 / median(cell.seconds[VPRSNN[0]]))} Hz on {cell.threads} core{'s' * (cell.threads != 1)}"
            for cell in asked
            if cell.modules == most
        ],
    }
