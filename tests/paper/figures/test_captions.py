"""Captions say what is drawn, of which data, and what a reader has to know: whole captions are those stored.

They are written anew, to be read before they are committed, where VPRBENCH_STORE_DOCUMENTS is set.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import little
import numpy as np
from checkout import ROOT
from figure_runs import five_rows, run, series, sized

from vprbench.metrics.ranking import outcome
from vprbench.paper.figures.accuracy import precision_recall, recall_at_n, recall_at_tolerance
from vprbench.paper.figures.growth import growth
from vprbench.paper.figures.pictures import frames, similarity
from vprbench.paper.figures.speed import query_rate, training_time
from vprbench.paper.figures.spikes import spike_statistics
from vprbench.paper.figures.style import Drawn
from vprbench.paper.figures.tradeoff import against_memory, against_rate
from vprbench.paper.growth import samples
from vprbench.paper.plan import Row, read_plan
from vprbench.paper.selection import Series
from vprbench.run.note import Note
from vprbench.run.record import Run
from vprbench.run.thumbnails import Example, Thumbnails

STORED = Path(__file__).parent / "stored" / "captions.md"
PLAN = read_plan(ROOT / "conf" / "table.yaml")
ROWS = list(PLAN.rows.values())
NORDLAND, STREET = PLAN.columns["nordland"], PLAN.columns["street"]
UNPUBLISHED = replace(PLAN.columns["railway"], title="Railway (rendered), 225 places", published=None)
FIVE = five_rows(n_places=50)
ON_GPU = five_rows("cuda", n_places=50)
SIZES = (100, 300, 1000, 3000, 9000, 27000)
NOISY = (Note("noisy", "two carts passed"),)


def troubled() -> list[Series]:
    """Return a tuned row, one on a GPU, and one on a busy machine with ties beyond what is stored."""
    tuned = run("mine", 0.5, tuned_on={"dataset": "railway", "places": "the first 9 places"})
    tied = run("gcl", 0.3, notes=NOISY)
    tied = replace(tied, outcome=replace(tied.outcome, top_tied=np.full(40, 30)))
    rows = [series("Mine", tuned), series("SAD", run("sad", device="cuda")), series("GCL", tied)]
    return [replace(row, runs=tuple(replace(r, protocol={"tolerance_places": 2}) for r in row.runs)) for row in rows]


def unanswered() -> Series:
    """Return two seeds of which one query has no right place."""
    runs = [little.a_run(config={**little.a_run().config, "seed": seed}) for seed in (0, 1)]
    positives = (*runs[0].positives[:3], np.empty(0, np.int64))
    scores = np.asarray(runs[0].scores)
    return series("VPRTempo", *(replace(r, positives=positives, outcome=outcome(scores, positives)) for r in runs))


def grown(name: str, training: Callable[[int], float | None], query: Callable[[int], float], *more: Run) -> Any:
    wobble = (1.01, 0.99) * 3
    made = [
        sized(n, None if (t := training(n)) is None else t * w, query(n) * w, encode_seconds=0.002)
        for n, w in zip(SIZES, wobble, strict=True)
    ]
    return samples(Row(name, name.lower(), None if name == "CosPlace" else "match"), [*made, *more], ())


def of_growth() -> Iterator[tuple[str, list[Any]]]:
    claimed = grown("VPRTempo", lambda n: 0.4 + 0.004 * n, lambda n: 0.001 * float(np.log(n)))
    yield "as claimed", [claimed]
    old = sized(300, 9.0, 0.009, code="older", time_utc="2024-01-01T00:00:00Z")
    seeds = [replace(sized(n, 0.01 * n, 0.001, seed=1), notes=NOISY) for n in (300, 9000)]
    yield (
        "not as claimed, among others",
        [
            grown("VPRTempo", lambda n: 2.0, lambda n: 1e-6 * n, old, *seeds),
            grown("CosPlace", lambda n: None, lambda n: 1e-6 * n),
        ],
    )
    undecided = [
        sized(n, 1.0, 0.001 * (1 + 0.001 * n) * (1.02, 0.98)[i % 2]) for i, n in enumerate(range(1000, 1500, 50))
    ]
    yield "undecided", [samples(Row("VPRTempo", "vprtempo", "match"), undecided, ())]
    yield "too few", [samples(Row("VPRTempo", "vprtempo", "match"), claimed.runs[:3], ())]


def spiking(name: str, n_queries: int) -> Series:
    layers = [
        little.a_layer(layer, size, [5] * n_queries, 0.5, None) for layer, size in (("input", 784), ("out", 1200))
    ]
    return series(name, *(little.a_run(spikes={"queries": n_queries, "layers": layers}) for _ in range(2)))


def all_drawn() -> Iterator[tuple[str, Drawn]]:
    for draw in (precision_recall, recall_at_n, recall_at_tolerance, against_rate, against_memory):
        name = draw.__name__
        yield f"{name} of five rows", draw(FIVE)
        yield f"{name} of troubled rows", draw(troubled())
        yield f"{name} of two seeds", draw([unanswered()])
    for draw in (training_time, query_rate):
        name = draw.__name__
        yield f"{name} on two devices", draw(FIVE, ON_GPU, ROWS, NORDLAND, {})
        yield f"{name} of what stands in", draw(FIVE[-1:], (), ROWS, STREET, {})
        yield f"{name} outside of the paper", draw(troubled()[2:], (), [Row("GCL", "gcl")], UNPUBLISHED, {})
    for kind, rows in of_growth():
        yield f"growth {kind}", growth(rows)
    grey = np.zeros((45, 80, 3), np.uint8)
    examples = Example(0, 2, grey, grey), Example(1, 0, grey, grey)
    names = tuple(f"{i}.png" for i in range(3))
    yield "frames", frames(Thumbnails(names, names, examples, (b"",) * 3, (b"",) * 3), "Railway")
    yield "similarity", similarity(FIVE[-1].runs[1], "VPRTempo, five networks")
    yield "similarity of a large map", similarity(run(n_queries=20, n_places=1000))
    yield (
        "spikes",
        spike_statistics([series("SAD", little.a_run(spikes=None)), spiking("VPRTempo", 3), spiking("VPRSNN", 1200)]),
    )


def test_captions_are_the_stored_ones() -> None:
    text = "\n".join(f"## {name}\n\n{drawn.caption}\n" for name, drawn in all_drawn())
    if "VPRBENCH_STORE_DOCUMENTS" in os.environ:
        STORED.write_text(text, encoding="utf-8")
    assert text == STORED.read_text(encoding="utf-8")
