"""What the benchmark of speed says of VPRSNN, beside what the paper printed."""

from __future__ import annotations

from vprbench.paper.plan import published
from vprbench.paper.table.reasons import PAPER, PAPER_CPU
from vprbench.speed.format import figures, milliseconds, ratio, table
from vprbench.speed.measure import median
from vprbench.speed.settings import LOOKED, TRAVERSES, VPRSNN, AskingCell, ModuleCell, Report

_PAPER_PLACES, _PAPER_MODULE = 3300, 25  # of VPRSNN on Nordland
_PAPER_MODULES = _PAPER_PLACES // _PAPER_MODULE


def training(report: Report) -> list[str]:
    """Return the section on the training of a module."""
    settings = report.settings
    return [
        "## A module of VPRSNN on one core",
        f"{settings.vprsnn_places} places, {TRAVERSES} traverses, {settings.vprsnn_epochs} epochs, "
        f"{settings.pixels}x{settings.pixels} inputs, {settings.vprsnn_neurons} excitatory neurons and as many "
        "inhibitory ones, by the compiled loops on the CPU. A synaptic arrival is one input spike at one excitatory "
        "neuron. `vprsnn_fast` leaves out the delays from the input: an approximation, not VPRSNN. The time is the "
        "median of whole fits, their number in brackets.",
        table(report.vprsnn_training, _training_row),
        f"Where the time goes, in one further training: parts of the summed times of every {LOOKED}th presentation. "
        "Summing arrivals is timed alone, on the same input spikes and weights; the rest of the simulation is the "
        "presentation shown without learning less that sum, learning the presentation itself less the one without "
        "learning.",
        table(report.vprsnn_training, _parts_row),
        *_printed_training(report),
    ]


def queries(report: Report) -> list[str]:
    """Return the section on queries."""
    return [
        "## Queries to many modules of VPRSNN",
        "One image at a time, with and without delays in turn, from image to scores. The modules are copies of the "
        "trained one, in memory and with delays of their own; the images show places of the whole route, so that most "
        "of them are foreign to it.",
        table(report.vprsnn_queries, _asking_row),
        *_printed_queries(report),
    ]


def shares(cell: ModuleCell) -> dict[str, float]:
    """Return which part of a presentation, 0 to 1, goes where; together 1."""
    seconds = {part: sum(laps) for part, laps in cell.parts.items()}
    whole = seconds["input"] + seconds["normalising"] + seconds["with learning"]
    parts = {
        "drawing input spikes": seconds["input"],
        "summing arrivals": seconds["arrivals"],
        "rest of the simulation": seconds["without learning"] - seconds["arrivals"],
        "learning": seconds["with learning"] - seconds["without learning"],
        "normalising weights": seconds["normalising"],
    }
    return {part: each / whole for part, each in parts.items()}


def _training_row(cell: ModuleCell) -> dict[str, str]:
    seconds = _fit_seconds(cell)
    return {
        "method": cell.method,
        "fit s": f"{figures(seconds)} ({len(cell.fits)})",
        "presentations": f"{cell.presentations:,}",
        "ms each": milliseconds(seconds / cell.presentations),
        "input spikes": f"{cell.input_spikes:,}",
        "synaptic arrivals": f"{figures(cell.input_spikes * cell.neurons / 1e6)} million",
        "arrivals a second": f"{figures(cell.input_spikes * cell.neurons / seconds / 1e6)} million",
        "excitatory spikes": f"{cell.excitatory_spikes:,}",
    }


def _parts_row(cell: ModuleCell) -> dict[str, str]:
    looked = len(cell.parts["with learning"])
    seconds = sum(sum(cell.parts[part]) for part in ("input", "normalising", "with learning"))
    return {
        "method": cell.method,
        "presentations": f"{looked:,}",
        "ms each": milliseconds(seconds / looked),
        **{part: f"{100 * share:.1f} %" for part, share in shares(cell).items()},
    }


def _asking_row(cell: AskingCell) -> dict[str, str]:
    seconds = {method: median(laps) for method, laps in cell.seconds.items()}
    return {
        "modules": str(cell.modules) + f" of {cell.wanted}: memory is short" * (cell.modules < cell.wanted),
        "places": f"{cell.places:,}",
        "cores": str(cell.threads),
        **{f"{method}: ms": milliseconds(each) for method, each in seconds.items()},
        **{f"{method}: Hz": figures(1 / each) for method, each in seconds.items()},
        " / ".join(VPRSNN): ratio(*(seconds[method] for method in VPRSNN)),
    }


def _fit_seconds(cell: ModuleCell) -> float:
    return median(fit.seconds for fit in cell.fits)


def _printed_training(report: Report) -> list[str]:
    """Say what was measured beside what the paper printed, where a module was measured."""
    found = [
        f"{cell.method} {figures(_fit_seconds(cell))} s"
        for cell in report.vprsnn_training
        if isinstance(cell, ModuleCell)
    ]
    minutes = published()["VPRSNN", "Nordland"]["train_cpu"]
    if not found or minutes is None:
        return []
    return [
        f"Measured trainings of one module of {report.settings.vprsnn_places} places, on one core: "
        f"{', '.join(found)}. The paper prints {minutes:.0f} min for {_PAPER_PLACES:,} places ({PAPER}; {PAPER_CPU}): "
        f"{60 * minutes / _PAPER_MODULES:.0f} s for each of its {_PAPER_MODULES} modules of {_PAPER_MODULE}."
    ]


def _printed_queries(report: Report) -> list[str]:
    """Say what was measured beside what the paper printed, for the most modules on each number of cores."""
    cells = [cell for cell in report.vprsnn_queries if isinstance(cell, AskingCell)]
    hz = published()["VPRSNN", "Nordland"]["query_cpu"]
    if not cells or hz is None:
        return []
    most = max(cell.modules for cell in cells)
    found = [
        f"{figures(1 / median(cell.seconds[VPRSNN[0]]))} Hz on {cell.threads} core{'s' * (cell.threads != 1)}"
        for cell in cells
        if cell.modules == most
    ]
    return [
        f"Measured {VPRSNN[0]} queries to {most:,} modules, {most * report.settings.vprsnn_places:,} places: "
        f"{', '.join(found)}. The paper prints {hz:.0f} Hz for {_PAPER_PLACES:,} places, {_PAPER_MODULES} modules "
        f"({PAPER}; {PAPER_CPU})."
    ]
