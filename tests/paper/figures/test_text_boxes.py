"""In no figure, however many rows it has and however long their names are, does a text cover another or leave it."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations, cycle

import little
import numpy as np
import pytest
from checkout import ROOT
from figure_runs import run, series, sized
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.text import Text

from vprbench.metrics.registry import METRICS
from vprbench.paper.figures.accuracy import precision_recall, recall_at_n, recall_at_tolerance
from vprbench.paper.figures.growth import growth
from vprbench.paper.figures.metrics import of_rows
from vprbench.paper.figures.pictures import frames, similarity
from vprbench.paper.figures.speed import query_rate, training_time
from vprbench.paper.figures.spikes import spike_statistics
from vprbench.paper.figures.style import Drawn
from vprbench.paper.figures.tradeoff import against_memory, against_rate
from vprbench.paper.growth import samples
from vprbench.paper.plan import Row, read_plan
from vprbench.paper.selection import Series
from vprbench.run.thumbnails import Example, Thumbnails

LONG = "VPRTempo (5 networks, tuned, calibrated)"
NAMES = ("SAD", "NetVLAD", "GCL", "VPRSNN", "VPRTempo", LONG, "CosPlace", "Patch-NetVLAD (rescored)", "mixvpr", "hog")
LAYERS = {
    "VPRSNN": (("input", 784), ("excitatory", 13200), ("inhibitory", 13200)),
    "VPRTempo": (("input", 784), ("feature", 1568), ("output", 3300)),
}
TOLERANCE = 1.0  # pixel


def rows(device: str = "cpu") -> list[Series]:
    """Return ten rows of two seeds whose numbers lie near one another, or decades apart."""
    return [
        series(
            name,
            *(
                run(
                    name.lower(),
                    0.3 + 0.05 * i,
                    8,
                    12,
                    seed=seed,
                    device=device,
                    fit_seconds=10.0 * 7 ** (i % 5) * (1 + seed),
                    fit_compute_seconds=8.0 * 7 ** (i % 5),
                    encode_seconds=0.001 * 3 ** (i % 6),
                    peak_memory_bytes=300_000_000 * (1 + i % 4),
                    bytes_per_place=None if i % 2 else 1024 * (i + 1),
                )
                for seed in (0, 1)
            ),
        )
        for i, name in enumerate(NAMES)
    ]


def spiking(name: str, kind: str) -> Series:
    random = np.random.default_rng(0)
    layers = [little.a_layer(layer, n, list(random.poisson(n / 2, 9)), 0.4, None) for layer, n in LAYERS[kind]]
    return series(name, little.a_run(spikes={"queries": 9, "layers": layers}))


def thumbnails(height: int, width: int) -> Thumbnails:
    frame, names = np.zeros((height, width, 3), np.uint8), tuple(f"{i}.png" for i in range(9))
    return Thumbnails(names, names, tuple(Example(i, i, frame, frame) for i in range(4)), (b"",) * 9, (b"",) * 9)


def every_kind() -> Iterator[tuple[str, Drawn]]:
    plan = read_plan(ROOT / "conf" / "table.yaml")
    planned = [plan.rows.get(name, Row(name, name.lower())) for name in NAMES]
    ten, on_gpu = rows(), rows("cuda")
    for draw in (precision_recall, recall_at_n, recall_at_tolerance, against_rate, against_memory):
        yield draw.__name__, draw(ten)
    for bars in (training_time, query_rate):
        yield f"{bars.__name__} on two devices", bars(ten, on_gpu, planned, plan.columns["nordland"], {})
        words = dict.fromkeys(((name, "query_cpu") for name in NAMES), "not applicable")
        yield f"{bars.__name__} of one row", bars(ten[:1], (), planned, plan.columns["railway_vprsnn"], words)
    yield "metric", of_rows(ten, METRICS["recall_at_5"])
    grown = [
        samples(Row(name, "vprtempo"), [sized(n, 0.4 + n / 250, 1e-6 * n * i) for n in (100, 900, 9000, 27000)], ())
        for i, name in enumerate(NAMES[:8], 1)
    ]
    yield "growth of eight rows", growth(grown)
    yield "growth of one row", growth(grown[:1])
    for kind, size in (("tall", (90, 30)), ("wide", (30, 90))):
        yield f"{kind} frames", frames(thumbnails(*size), "Railway")
    for n_queries, n_places in ((5, 400), (400, 30)):
        yield f"similarity {n_queries}", similarity(run(n_queries=n_queries, n_places=n_places), LONG)
    kinds = zip(("VPRTempo", LONG, "VPRSNN", "VPRTempo (public code)"), cycle(("VPRTempo", "VPRTempo", "VPRSNN")))
    networks = [spiking(name, kind) for name, kind in kinds]
    for number in (1, 4):
        yield f"spikes of {number}", spike_statistics(networks[:number])


def shown(figure: Figure) -> list[Text]:
    """Return the texts that a reader sees: a tick beyond the ends of its axis is not drawn."""
    figure.draw_without_rendering()
    hidden: set[Text] = set()
    for axis in figure.findobj(Axis):
        low, high = sorted(axis.get_view_interval())
        for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()):
            if not low <= tick.get_loc() <= high:
                hidden |= {tick.label1, tick.label2}
    return [
        text for text in figure.findobj(Text) if text.get_text().strip() and text.get_visible() and text not in hidden
    ]


@pytest.mark.filterwarnings("error")
def test_no_text_of_any_figure_covers_another_or_is_cut() -> None:
    for name, drawn in every_kind():
        figure = drawn.figure
        boxes = [(text.get_text(), Text.get_window_extent(text)) for text in shown(figure)]  # without arrows
        canvas = figure.bbox.padded(TOLERANCE)
        cut = [text for text, box in boxes if not (canvas.contains(*box.min) and canvas.contains(*box.max))]
        covered = [
            (text, other)
            for (text, one), (other, two) in combinations(boxes, 2)
            if min(one.x1, two.x1) - max(one.x0, two.x0) > TOLERANCE
            and min(one.y1, two.y1) - max(one.y0, two.y0) > TOLERANCE
        ]
        assert (name, cut, covered) == (name, [], [])
