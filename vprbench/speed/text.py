"""The benchmark of speed for people: its report as Markdown, and as JSON with every lap."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

from vprbench.run.machine import machine_lines
from vprbench.run.rows import markdown
from vprbench.run.summary import StageRates
from vprbench.speed import reading_text, vprsnn_text
from vprbench.speed.format import figures, megabytes, milliseconds, ratio, table
from vprbench.speed.measure import Growth, growth, median
from vprbench.speed.settings import (
    FRAME,
    RULES,
    TRAVERSES,
    FitCell,
    PreprocessingCell,
    QueryCell,
    Report,
    ScalingCell,
    SearchCell,
    TrainingCell,
)
from vprbench.storage.atomic import replace_text

_NOISE = 0.05  # drift of a fixed computation that marks a section as noisy
_LARGE = 1000  # places from which on the growth is looked at apart: there are about as many modules as places ask for

_COUNTED = {
    "network": "all weights of both layers",
    "matrix": "the product of both layers, places x pixels",
    "references": "the reference images, images x pixels",
}


def write(report: Report, results: Path) -> None:
    """Print the report as Markdown, and leave it with all laps in bench.md and bench.json of the folder `results`."""
    text = text_of(report)
    replace_text(results / "bench.json", json.dumps(asdict(report), allow_nan=False))
    replace_text(results / "bench.md", text)
    print(text, end="")
    print(f"\nwritten to {results / 'bench.md'} and {results / 'bench.json'}")


def text_of(report: Report) -> str:
    """Return a report as Markdown."""
    parts = [
        "# How fast this is here",
        f"Everything below was measured in one run of {report.seconds / 60:.1f} minutes on one machine, from images "
        f"in memory ({FRAME[1]}x{FRAME[0]} frames, smooth random ones and noisy copies of them) where no files are "
        "named. Nothing is extrapolated. Times are medians where there are several, ratios those of medians.",
        *_warnings(report),
        *_sections(report),
        "## Machine",
        *_machine(report),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _sections(report: Report) -> list[str]:
    """Return the text of the sections that were measured."""
    settings = report.settings
    texts: dict[str, Callable[[], list[str]]] = {
        "training": lambda: [
            "## A training step, fused against readable",
            f"One module of {settings.max_module:,} places, {TRAVERSES} traverses, 1 epoch, {settings.rounds} rounds "
            "in turn. A step shows one image to both layers; its time is the training's from its first report to its "
            "last. The floor is a plain pass in place (PyTorch's `mul_`) over as many bytes as excitation and "
            "inhibition of both layers have, with the same threads.",
            table(report.training, _training_row),
        ],
        "fits": lambda: [
            "## The fit that users ask for",
            f"{settings.places:,} places, {TRAVERSES} traverses, {settings.epochs} epochs, modules of up to "
            f"{settings.max_module:,} places. A stage begins with its first report of progress, so up to one part in a "
            "hundred of it counts as the stage before. The peak is this process's resident memory, the images and "
            "libraries that were there before included.",
            table(report.fits, _fit_row),
        ],
        "reading": lambda: reading_text.reading(report),
        "preprocessing": lambda: [
            "## Preprocessing",
            f"Patch normalisation to {settings.pixels}x{settings.pixels} pixels (variant C), engines in turn.",
            table(report.preprocessing, _preprocessing_row),
        ],
        "queries": lambda: [
            f"## Queries at {settings.places:,} places",
            "Encode needs no map, match scores all places. Streaming is one image at a time (1 / median), offline the "
            "fastest batch size (images / time). The floor is one plain read (PyTorch's `sum`) of as many bytes as are "
            "counted, with the same threads. Single queries of the paper's rules leave out the output weights of "
            "silent features, so they may read less than what is counted.",
            table(report.queries, _query_row),
        ],
        "search": lambda: [
            "## Matching beside a library",
            "The same arrays in the same process, calls of each in turn, libraries first set up. Ours scores every "
            "place; faiss returns the best 100, torch.cdist all distances of floats. Of a whole traverse ours names "
            "the best 100 too, in blocks as a run does. The memory is what a call of ours takes beyond what was "
            "resident; the peak is that of the process, both copies of the references included.",
            table(report.search, _search_row),
        ],
        "scaling": lambda: [
            "## Growth with the number of places",
            f"1 traverse, {settings.scaling_epochs} epoch{'s' * (settings.scaling_epochs != 1)}, modules of up to "
            f"{settings.max_module:,} places: up to there one module grows, from there on their number.",
            table(report.scaling, _scaling_row),
            "The exponent b of t = a * n^b, by least squares on the logarithms, with the 95 % interval of its "
            "residuals:",
            markdown(_growth_rows(report)),
            *_claims(report),
        ],
        "vprsnn_training": lambda: vprsnn_text.training(report),
        "vprsnn_queries": lambda: vprsnn_text.queries(report),
    }
    return [part for name, text in texts.items() if name in settings.sections for part in text()]


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
        "peak MB": megabytes(fit.peak_memory_bytes),
        "resident before MB": megabytes(fit.memory_before_bytes),
        **_device_memory(fit.peak_device_memory_bytes),
    }


def _preprocessing_row(cell: PreprocessingCell) -> dict[str, str]:
    each = {engine: median(seconds) / cell.images_per_call for engine, seconds in cell.seconds.items()}
    return {
        "frame": f"{cell.width}x{cell.height}",
        "images a call": str(cell.images_per_call),
        **{f"{engine}: us an image": figures(1e6 * seconds) for engine, seconds in each.items()},
        "readable / fused": ratio(each["readable"], each["fused"]),
    }


def _query_row(cell: QueryCell) -> dict[str, str]:
    floor = median(cell.floor_seconds)
    return {
        "method": cell.method,
        **_rate_columns(cell.rates.streaming, cell.rates.offline, cell.rates.offline_batch, cell.rates.valid),
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


def _rate_columns(streaming: StageRates, offline: StageRates, batch: int, valid: bool) -> dict[str, str]:
    return {
        "streaming Hz enc/match/total": rates_text(streaming) + ("" if valid else " INVALID"),
        "offline Hz enc/match/total": f"{rates_text(offline)} (batch {batch})" + ("" if valid else " INVALID"),
    }


def rates_text(rates: StageRates) -> str:
    """Return the rates of both stages and of the total."""
    return " / ".join(
        f"{rate:,.0f}" if rate >= 10 else f"{rate:.2g}" for rate in (rates.encode, rates.match, rates.total)
    )


def _scaling_row(cell: ScalingCell) -> dict[str, str]:
    fit = cell.fits[0]
    return {
        "rules": cell.rules,
        "places": f"{cell.places:,}",
        "fit s": f"{figures(_fit_seconds(cell))} ({len(cell.fits)})",
        "streaming Hz": rates_text(cell.rates.streaming).split(" / ")[-1],
        "offline Hz": f"{rates_text(cell.rates.offline).split(' / ')[-1]} (batch {cell.rates.offline_batch})",
        "peak MB": megabytes(fit.peak_memory_bytes),
        "resident before MB": megabytes(fit.memory_before_bytes),
        **_device_memory(fit.peak_device_memory_bytes),
    }


def _fit_seconds(cell: ScalingCell) -> float:
    return median(fit.seconds for fit in cell.fits)


_TIMES: dict[str, Callable[[ScalingCell], float]] = {
    "fit": _fit_seconds,
    "query, streaming": lambda cell: 1 / cell.rates.streaming.total,
    "query, offline": lambda cell: 1 / cell.rates.offline.total,
}


def _grown(report: Report, rules: str, time: str, least: int = 0) -> tuple[list[int], Growth | None]:
    """Return the sizes that were measured, from `least` places on, and how a time grows over them."""
    cells = [cell for cell in _measured(report, rules) if cell.places >= least]
    sizes = [cell.places for cell in cells]
    return sizes, growth(sizes, [_TIMES[time](cell) for cell in cells])


def _growth_rows(report: Report) -> list[dict[str, str]]:
    return [
        {
            "rules": rules,
            "time": time,
            "b, all sizes": _exponent(*_grown(report, rules, time)),
            f"b, from {_LARGE:,} places": _exponent(*_grown(report, rules, time, _LARGE)),
        }
        for rules in RULES
        for time in _TIMES
    ]


def _exponent(sizes: Sequence[int], found: Growth | None) -> str:
    if found is None:
        return f"{len(sizes)} sizes: needs two"
    if found.low is None or found.high is None:
        return f"{found.exponent:.2f} (2 sizes, no interval)"
    return f"{found.exponent:.2f} [{found.low:.2f}, {found.high:.2f}] ({len(sizes)} sizes)"


def _claims(report: Report) -> list[str]:
    """Say what was measured beside what the paper claims, a sentence for training and one for queries."""
    return [
        f"Measured {what}: {'; '.join(found)}. {claim}."
        for what, times, claim in (
            ("fits", ["fit"], "The paper claims O(n) for training"),
            ("queries", ["query, streaming", "query, offline"], "The paper claims O(log n) for a query"),
        )
        if (found := [text for rules in RULES if (text := _grown_text(report, rules, times))])
    ]


def _grown_text(report: Report, rules: str, times: Sequence[str]) -> str | None:
    """Return how times grow from the smallest size to the largest, beside n and log n."""
    cells = _measured(report, rules)
    if len(cells) < 2 or cells[0].places < 2:
        return None
    first, last = cells[0], cells[-1]
    grown = [
        f"{time}: {ratio(seconds(last), seconds(first))}, as n^{_exponent(*_grown(report, rules, time))}"
        for time, seconds in _TIMES.items()
        if time in times
    ]
    return (
        f"{rules} rules, from {first.places:,} to {last.places:,} places (n grows {ratio(last.places, first.places)}, "
        f"log n {ratio(math.log(last.places), math.log(first.places))}): {', '.join(grown)}"
    )


def _measured(report: Report, rules: str) -> list[ScalingCell]:
    return [cell for cell in report.scaling if isinstance(cell, ScalingCell) and cell.rules == rules]


def _warnings(report: Report) -> list[str]:
    found = []
    if report.settings.quick:
        found.append("**quick=true: tiny sizes, so these numbers show that everything runs and nothing else.**")
    before = report.canary_seconds["start"]
    drifts = {name: seconds / before for name, seconds in report.canary_seconds.items() if name != "start"}
    noisy = [f"{name} {drift:.2f}" for name, drift in drifts.items() if abs(drift - 1) > _NOISE]
    if noisy:
        found.append(f"**Noisy:** a fixed computation took so many times as long after {', '.join(noisy)}.")
    return found


def _machine(report: Report) -> list[str]:
    return [*machine_lines(report.environment), _load_line(report)]


def _load_line(report: Report) -> str:
    start = report.canary_seconds["start"]
    drifts = ", ".join(
        f"{name} {seconds / start:.2f}" for name, seconds in report.canary_seconds.items() if name != "start"
    )
    pressure = (report.environment["cpu_pressure_avg10"], report.cpu_pressure_avg10_after)
    return (
        f"Load average before {_numbers(report.environment['load_average'])}, after "
        f"{_numbers(report.load_average_after)}. CPU pressure before and after: "
        f"{', '.join('unknown' if share is None else f'{share:.0f} %' for share in pressure)}. "
        f"A fixed computation took, after each section and as a multiple of the start: {drifts}."
    )


def _numbers(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.2f}" for value in values)


def _device_memory(n_bytes: int | None) -> dict[str, str]:
    return {} if n_bytes is None else {"peak device MB": megabytes(n_bytes)}
