"""A row for each cell of the benchmark of speed."""

from __future__ import annotations

from vprbench.speed.cells import (
    AskingCell,
    FitCell,
    ModuleCell,
    PreprocessingCell,
    QueryCell,
    ReadingCell,
    Report,
    ScalingCell,
    SearchCell,
    TrainingCell,
)
from vprbench.speed.format import figures, hertz, megabytes, milliseconds, rates_text, ratio, size, table
from vprbench.speed.measure import Fit, median
from vprbench.speed.settings import VPRSNN

_COUNTED = {
    "network": "all weights of both layers",
    "matrix": "the product of both layers, places x pixels",
    "references": "the reference images, images x pixels",
}


def tables(report: Report) -> dict[str, str]:
    """Return the cells of each section as a table in Markdown; what could not be measured has its row."""
    return {
        "training": table(report.training, _training_row),
        "fits": table(report.fits, _fit_row),
        "reading": table(report.reading, reading_row),
        "preprocessing": table(report.preprocessing, _preprocessing_row),
        "queries": table(report.queries, _query_row),
        "search": table(report.search, _search_row),
        "scaling": table(report.scaling, _scaling_row),
        "vprsnn_training": table(report.vprsnn_training, module_row),
        "vprsnn_parts": table(report.vprsnn_training, parts_row),
        "vprsnn_queries": table(report.vprsnn_queries, asking_row),
    }


def _training_row(cell: TrainingCell) -> dict[str, str]:
    steps = {engine: median(fit.training_seconds for fit in fits) / cell.steps for engine, fits in cell.fits.items()}
    fits = {engine: median(fit.seconds for fit in fits) for engine, fits in cell.fits.items()}
    floor = median(cell.floor_seconds)
    return {
        "rules": cell.rules,
        **{f"{engine}: fit s": figures(seconds) for engine, seconds in fits.items()},
        "fit, readable / fused": ratio(fits["readable"], fits["fused"]),
        **{f"{engine}: step ms": milliseconds(seconds) for engine, seconds in steps.items()},
        "step, readable / fused": ratio(steps["readable"], steps["fused"]),
        f"floor ms ({figures(cell.floor_bytes / 1e6)} MB)": milliseconds(floor),
        **{f"{engine} / floor": ratio(seconds, floor) for engine, seconds in steps.items()},
    }


def _fit_row(cell: FitCell) -> dict[str, str]:
    fit = cell.fit
    return {
        "rules": cell.rules,
        "fit s": figures(fit.seconds),
        **{f"{stage} s": figures(seconds) for stage, seconds in fit.stages.items()},
        **_memory(cell.fit),
    }


def _preprocessing_row(cell: PreprocessingCell) -> dict[str, str]:
    each = {engine: median(seconds) / cell.images_per_call for engine, seconds in cell.seconds.items()}
    return {
        "frame": size(cell.height, cell.width),
        "images a call": str(cell.images_per_call),
        **{f"{engine}: us an image": figures(1e6 * seconds) for engine, seconds in each.items()},
        "readable / fused": ratio(each["readable"], each["fused"]),
    }


def _query_row(cell: QueryCell) -> dict[str, str]:
    floor = median(cell.floor_seconds)
    invalid = "" if cell.rates.valid else " INVALID"
    return {
        "method": cell.method,
        "streaming Hz enc/match/total": rates_text(cell.rates.streaming) + invalid,
        "offline Hz enc/match/total": f"{rates_text(cell.rates.offline)} (batch {cell.rates.offline_batch}){invalid}",
        "floor us": figures(1e6 * floor),
        "streaming match / floor": ratio(1 / cell.rates.streaming.match, floor),
        "floor reads": f"{figures(cell.floor_bytes / 1e6)} MB: {_COUNTED[cell.counted]}",
    }


def _search_row(cell: SearchCell) -> dict[str, str]:
    ours, library = median(cell.seconds), median(cell.library_seconds)
    return {
        "method": cell.method,
        "references": f"{cell.references:,} x {cell.dimensions:,}",
        "images a call": str(cell.images_per_call),
        "ours: ms": milliseconds(ours),
        "ours: Hz": figures(cell.images_per_call / ours),
        "library: ms": milliseconds(library),
        "ours / library": ratio(ours, library),
        "library": cell.library,
        "memory MB": megabytes(cell.memory_bytes),
        "peak MB": megabytes(cell.peak_memory_bytes),
    }


def reading_row(cell: ReadingCell) -> dict[str, str]:
    """Return what reading took; shares are medians over the turns."""
    turns = list(zip(cell.one_loop, cell.loops_at_once, cell.ahead, strict=True))
    return {
        "frame": size(cell.height, cell.width),
        "frames": f"{cell.frames:,}",
        "cores": str(cell.cores),
        "one bare loop: Hz": figures(median(cell.one_loop)),
        "loops at once: Hz": figures(median(cell.loops_at_once)),
        "ours: Hz": figures(median(cell.ahead)),
        "ours / (cores x one loop)": ratio(median(ours / one for one, _, ours in turns), cell.cores),
        "ours / loops at once": ratio(median(ours / several for _, several, ours in turns), 1),
        "resident before MB": megabytes(cell.memory_before_bytes),
        "peak MB": megabytes(cell.peak_memory_bytes),
    }


def _scaling_row(cell: ScalingCell) -> dict[str, str]:
    return {
        "rules": cell.rules,
        "places": f"{cell.places:,}",
        "fit s": f"{figures(fit_seconds(cell))} ({len(cell.fits)})",
        "streaming Hz": hertz(cell.rates.streaming.total),
        "offline Hz": f"{hertz(cell.rates.offline.total)} (batch {cell.rates.offline_batch})",
        **_memory(cell.fits[0]),
    }


def module_row(cell: ModuleCell) -> dict[str, str]:
    """Return what training a module of VPRSNN took."""
    seconds = fit_seconds(cell)
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


def parts_row(cell: ModuleCell) -> dict[str, str]:
    """Return where the time of the presentations that were timed goes."""
    looked = len(cell.parts["with learning"])
    seconds = sum(sum(cell.parts[part]) for part in ("input", "normalising", "with learning"))
    return {
        "method": cell.method,
        "presentations": f"{looked:,}",
        "ms each": milliseconds(seconds / looked),
        **{part: f"{100 * share:.1f} %" for part, share in shares(cell).items()},
    }


def asking_row(cell: AskingCell) -> dict[str, str]:
    """Return what queries to many modules took."""
    seconds = {method: median(laps) for method, laps in cell.seconds.items()}
    return {
        "modules": str(cell.modules) + f" of {cell.wanted}: memory is short" * (cell.modules < cell.wanted),
        "places": f"{cell.places:,}",
        "cores": str(cell.threads),
        **{f"{method}: ms": milliseconds(each) for method, each in seconds.items()},
        **{f"{method}: Hz": figures(1 / each) for method, each in seconds.items()},
        " / ".join(VPRSNN): ratio(*(seconds[method] for method in VPRSNN)),
    }


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


def _memory(fit: Fit) -> dict[str, str]:
    on_device = fit.peak_device_memory_bytes
    return {
        "peak MB": megabytes(fit.peak_memory_bytes),
        "resident before MB": megabytes(fit.memory_before_bytes),
        **({} if on_device is None else {"peak device MB": megabytes(on_device)}),
    }


def fit_seconds(cell: ScalingCell | ModuleCell) -> float:
    """Return the median seconds of the fits of a cell."""
    return median(fit.seconds for fit in cell.fits)
