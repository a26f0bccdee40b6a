"""The benchmark of speed: training, preprocessing, queries and how they grow, measured in one run on one machine."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import psutil

from vprbench.metrics.growth import exponent
from vprbench.paper.plan import PAPER, PAPER_CPU, published
from vprbench.runs import machine
from vprbench.speed import events, files, frames, matching, training, vprsnn
from vprbench.speed.measure import Make, median
from vprbench.speed.report import Planned, Report, figures, measured, publish, ratio
from vprbench.speed.route import Route
from vprbench.speed.settings import FRAME, RULES, SECTIONS, TRAVERSES, VPRSNN, Bench, Settings
from vprbench.speed.training import ScalingCell, fit_seconds
from vprbench.speed.vprsnn import AskingCell, ModuleCell

_NOISE = 0.05  # drift of a fixed computation that marks a section as noisy
_LARGE = 1000  # places from which on the growth is looked at apart: there are about as many modules as places ask for

_PLANS: tuple[Callable[[Bench], Iterator[Planned]], ...] = (
    training.training,
    training.fits,
    frames.reading,
    files.listing,
    events.counting,
    frames.preprocessing,
    matching.queries,
    matching.search,
    training.scaling,
    vprsnn.training,
    vprsnn.queries,
)


def measure(settings: Settings, make: Make) -> Report:
    """Measure all sections; what cannot be measured becomes a cell that says why."""
    started = time.perf_counter()
    surroundings = machine.capture(settings.device, settings.threads or len(machine.cores()))
    machine.canary_seconds()  # an idle processor needs a while to find its clock
    canary = {"start": machine.canary_seconds()}  # seconds of a fixed computation, then after each section
    places = max(settings.places, settings.max_module, settings.vprsnn_places, *settings.sizes)
    bench = Bench(settings, make, Route.drawn(places, *FRAME, settings.seed))
    sections = {}
    for name, planned in zip(SECTIONS, _PLANS, strict=True):
        sections[name] = list(measured(name, planned(bench))) if name in settings.sections else []
        canary[name] = machine.canary_seconds()
    about = {
        "canary_seconds": canary,
        "load_average_after": list(psutil.getloadavg()),
        "cpu_pressure_avg10_after": machine.cpu_pressure(),
        "seconds": time.perf_counter() - started,
    }
    return Report(settings, surroundings, sections, about)


def write(report: Report, results: Path) -> None:
    """Print the report as Markdown, and leave it with all laps in bench.md and bench.json of the folder `results`."""
    publish(results, {"bench.md": to_text(report), "bench.json": json.dumps(report.plain(), allow_nan=False)})


def to_text(report: Report) -> str:
    """Return a report as Markdown."""
    here, about = report.environment, report.about
    canary = about["canary_seconds"]
    drifts = {name: seconds / canary["start"] for name, seconds in canary.items() if name != "start"}
    pressures = (here["cpu_pressure_avg10"], about["cpu_pressure_avg10_after"])
    loads = (here["load_average"], about["load_average_after"])
    scaling = [cell for cell in report.sections["scaling"] if isinstance(cell, ScalingCell)]
    modules = [
        cell.parts_row() if isinstance(cell, ModuleCell) else cell.row() for cell in report.sections["vprsnn_training"]
    ]
    return report.told(
        "bench.md.j2",
        vprsnn_parts=modules,
        growth={"rows": _growth_rows(scaling), "claims": _claims(scaling)},
        vprsnn=_beside_the_paper(report),
        noisy=[f"{name} {drift:.2f}" for name, drift in drifts.items() if abs(drift - 1) > _NOISE],
        drifts=[f"{name} {drift:.2f}" for name, drift in drifts.items()],
        loads=[", ".join(f"{load:.2f}" for load in each) for each in loads],
        pressures=["unknown" if share is None else f"{share:.0f} %" for share in pressures],
        **{"FRAME": FRAME, "TRAVERSES": TRAVERSES, "PAPER": PAPER, "PAPER_CPU": PAPER_CPU},
    )


_TIMES: dict[str, Callable[[ScalingCell], float]] = {
    "fit": lambda cell: fit_seconds(cell.fits),
    "query, streaming": lambda cell: 1 / cell.rates.streaming.total,
    "query, offline": lambda cell: 1 / cell.rates.offline.total,
}


def _growth_rows(scaling: Sequence[ScalingCell]) -> list[dict[str, str]]:
    return [
        {
            "rules": rules,
            "time": time,
            "b, all sizes": grown([cell for cell in scaling if cell.rules == rules], seconds),
            f"b, from {_LARGE:,} places": grown(
                [cell for cell in scaling if cell.rules == rules and cell.places >= _LARGE], seconds
            ),
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


def _claims(scaling: Sequence[ScalingCell]) -> dict[str, list[str]]:
    """Return for fits and for queries how their times grow from the smallest size to the largest, by rules."""
    claims: dict[str, list[str]] = {"fits": [], "queries": []}
    for rules in RULES:
        cells = [cell for cell in scaling if cell.rules == rules]
        if len(cells) < 2 or cells[0].places < 2:
            continue
        first, last = cells[0], cells[-1]
        fit, *queries = (
            f"{time}: {ratio(seconds(last), seconds(first))}, as n^{grown(cells, seconds)}"
            for time, seconds in _TIMES.items()
        )
        title = (
            f"{rules} rules, from {first.places:,} to {last.places:,} places (n grows "
            f"{ratio(last.places, first.places)}, log n {ratio(math.log(last.places), math.log(first.places))})"
        )
        claims["fits"].append(f"{title}: {fit}")
        claims["queries"].append(f"{title}: {', '.join(queries)}")
    return claims


def _beside_the_paper(report: Report) -> dict[str, Any]:
    """Return what was measured of VPRSNN beside what the paper printed; queries are those to the most modules."""
    trained = [cell for cell in report.sections["vprsnn_training"] if isinstance(cell, ModuleCell)]
    asked = [cell for cell in report.sections["vprsnn_queries"] if isinstance(cell, AskingCell)]
    most = max((cell.modules for cell in asked), default=0)
    return {
        "printed": published()["VPRSNN", "Nordland"],
        "trained": [f"{cell.method} {figures(fit_seconds(cell.fits))} s" for cell in trained],
        "most": most,
        "asked": [
            f"{figures(1 / median(cell.seconds[VPRSNN[0]]))} Hz on {cell.threads} core{'s' * (cell.threads != 1)}"
            for cell in asked
            if cell.modules == most
        ],
    }
