"""What every figure keeps: captions, whole ones are stored; and what it refuses to draw.

The stored captions are written anew, to be read before they are committed, where VPRBENCH_STORE_DOCUMENTS is set.
"""

import os
from dataclasses import replace
from functools import partial
from pathlib import Path

import little
import numpy as np
import pytest
from checkout import ROOT
from figure_runs import five_rows, run, series, sized

from vprbench.errors import BadInput
from vprbench.metrics.ranking import outcome
from vprbench.metrics.registry import METRICS
from vprbench.paper.figures.accuracy import of_rows, precision_recall, recall_at_n, recall_at_tolerance
from vprbench.paper.figures.growth import growth
from vprbench.paper.figures.pictures import frames, similarity
from vprbench.paper.figures.speed import query_rate, training_time
from vprbench.paper.figures.spikes import spike_statistics
from vprbench.paper.figures.tradeoff import against_memory, against_rate
from vprbench.paper.growth import samples
from vprbench.paper.plan import Row, read_plan
from vprbench.runs.notes import Note
from vprbench.runs.thumbnails import Example, Thumbnails

STORED = Path(__file__).parent / "stored" / "captions.md"
PLAN = read_plan(ROOT / "conf" / "table.yaml")
ROWS = list(PLAN.rows.values())
NORDLAND, WINTER = PLAN.columns["nordland"], PLAN.columns["railway_winter"]
UNPUBLISHED = replace(PLAN.columns["railway"], title="Railway (rendered), 225 places", published=None)
SIZES = (100, 300, 1000, 3000, 9000, 27000)
NOISY = (Note("noisy", "two carts passed"),)
ACCURACY = (precision_recall, recall_at_n, recall_at_tolerance, against_rate, against_memory)


def troubled():
    """Return a tuned row, one on a GPU, and one on a busy machine with ties beyond what is stored."""
    tuned = run("mine", 0.5, tuned_on={"dataset": "railway", "places": "the first 9 places"})
    tied = run("gcl", 0.3, notes=NOISY)
    tied = replace(tied, outcome=replace(tied.outcome, top_tied=np.full(40, 30)))
    rows = [series("Mine", tuned), series("SAD", run("sad", device="cuda")), series("GCL", tied)]
    return [replace(row, runs=tuple(replace(r, protocol={"tolerance_places": 2}) for r in row.runs)) for row in rows]


def unanswered():
    """Return two seeds of which one query has no right place."""
    runs = [little.a_run(config={**little.a_run().config, "seed": seed}) for seed in (0, 1)]
    positives = (*runs[0].positives[:3], np.empty(0, np.int64))
    scores = np.asarray(runs[0].scores)
    return series("VPRTempo", *(replace(r, positives=positives, outcome=outcome(scores, positives)) for r in runs))


def grown(name, training, query, *more):
    made = []
    for n, wobble in zip(SIZES, (1.01, 0.99) * 3, strict=True):
        fit = training(n)
        made.append(sized(n, None if fit is None else fit * wobble, query(n) * wobble, encode_seconds=0.002))
    return samples(Row(name, name.lower(), None if name == "CosPlace" else "match"), [*made, *more])


def of_growth():
    claimed = grown("VPRTempo", lambda n: 0.4 + 0.004 * n, lambda n: 0.001 * float(np.log(n)))
    yield "of one row", [claimed]
    old = sized(300, 9.0, 0.009, code="older", time_utc="2024-01-01T00:00:00Z")
    seeds = [replace(sized(n, 0.01 * n, 0.001, seed=1), notes=NOISY) for n in (300, 9000)]
    constant = grown("VPRTempo", lambda n: 2.0, lambda n: 1e-6 * n, old, *seeds)
    yield "of two rows", [constant, grown("CosPlace", lambda n: None, lambda n: 1e-6 * n)]
    yield "of two sizes", [samples(Row("VPRTempo", "vprtempo", "match"), claimed.runs[:2])]


def spiking(name, n_queries, *layers):
    random = np.random.default_rng(0)
    made = [little.a_layer(layer, n, list(random.poisson(n / 2, n_queries)), 0.4, None) for layer, n in layers]
    return series(name, *(little.a_run(spikes={"queries": n_queries, "layers": made}) for _ in range(2)))


def thumbnails():
    frame, names = np.zeros((30, 90, 3), np.uint8), tuple(f"{i}.png" for i in range(9))
    return Thumbnails(names, names, tuple(Example(i, i + 1, frame, frame) for i in range(4)), (b"",) * 9, (b"",) * 9)


def every_kind():
    five = five_rows(n_places=50)
    for draw in ACCURACY:
        rows = {"five rows": five, "one seed": five[:1], "troubled rows": troubled(), "two seeds": [unanswered()]}
        for kind, given in rows.items():
            yield f"{draw.__name__} of {kind}", draw(given)
    words = dict.fromkeys(((name, "query_cpu") for name in PLAN.rows), "not applicable")
    for bars in (training_time, query_rate):
        yield f"{bars.__name__} on two devices", bars(five, five_rows("cuda", n_places=50), ROWS, NORDLAND, {})
        yield f"{bars.__name__} of one row", bars(five[:1], (), ROWS, PLAN.columns["railway_vprsnn"], words)
        yield f"{bars.__name__} of what stands in", bars(five[-1:], (), ROWS, WINTER, {})
        yield f"{bars.__name__} outside of the paper", bars(troubled()[2:], (), [Row("GCL", "gcl")], UNPUBLISHED, {})
    yield "metric", of_rows(five, METRICS["recall_at_5"])
    for kind, grew in of_growth():
        yield f"growth {kind}", growth(grew)
    yield "frames", frames(thumbnails(), "Railway")
    yield "similarity", similarity(five[-1].runs[1], "VPRTempo (public code)")
    yield "similarity of 5", similarity(run(n_queries=5, n_places=1000))
    tempo = spiking("VPRTempo", 1200, ("input", 784), ("feature", 1568), ("output", 3300))
    snn = spiking("VPRSNN", 1200, ("input", 784), ("excitatory", 13200), ("inhibitory", 13200))
    yield "spikes of one", spike_statistics([series("SAD", little.a_run(spikes=None)), tempo])
    yield "spikes of two", spike_statistics([tempo, snn])


@pytest.mark.extended
def test_captions_are_the_stored_ones():
    text = "\n".join(f"## {name}\n\n{drawn.caption}\n" for name, drawn in every_kind())
    if "VPRBENCH_STORE_DOCUMENTS" in os.environ:
        STORED.write_text(text, encoding="utf-8")
    assert text == STORED.read_text(encoding="utf-8")


SPIKING = {"spikes": {"queries": 4, "layers": [little.a_layer("output", 100, [1, 2, 3, 4], 0.5, None)]}}
FIRST = series("VPRTempo", little.a_run(**SPIKING))
UNTIMED = [series("SAD", little.a_run(timing=None))]
BARS = {"gpu": (), "rows": ROWS, "column": NORDLAND, "marks": {}}


@pytest.mark.parametrize(
    ("draw", "given", "culprit"),
    [
        *(
            (draw, [FIRST, series("GCL", little.a_run(**SPIKING, **other))], "different data")
            for draw in (*ACCURACY, spike_statistics)
            for other in ({"fingerprint": "e" * 64}, {"protocol": {"tolerance_places": 1}})
        ),
        *((draw, [], "no stored runs") for draw in ACCURACY),
        *((draw, [series("SAD", little.unanswerable_run())], "journey has a right place") for draw in ACCURACY),
        (spike_statistics, [series("SAD", little.a_run(spikes=None))], "holds spikes"),
        (growth, [], "no growth"),
        (partial(training_time, **BARS), (), "Nordland"),
        (against_rate, UNTIMED, "no timed runs .*timing=quick"),
        (partial(query_rate, **BARS), UNTIMED, "Nordland"),
        (partial(frames, title="Railway"), Thumbnails((), (), (), (), ()), "Railway"),
        (similarity, little.a_run(scores=None), "0123456789abcdef of little on journey .*4 queries x 10 places"),
    ],
)
def test_what_cannot_be_drawn_is_refused_by_name(draw, given, culprit):
    with pytest.raises(BadInput, match=culprit):
        draw(given)
