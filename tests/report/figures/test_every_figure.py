"""Captions name data, seeds and machines; a figure without anything to draw is refused by name."""

from functools import partial

import little
import pytest
from figure_runs import run, series
from stored_runs import PAPER

from vprbench.errors import BadInput
from vprbench.report.figures.accuracy import draw_precision_recall, draw_recall_at_n, draw_recall_at_tolerance
from vprbench.report.figures.growth import draw_growing_map, draw_growth
from vprbench.report.figures.pictures import draw_frames, draw_similarity
from vprbench.report.figures.speed import draw_query_rate, draw_training_time
from vprbench.report.figures.spikes import draw_raster, draw_spikes
from vprbench.report.figures.tradeoff import draw_memory_tradeoff, draw_rate_tradeoff
from vprbench.runs.notes import Note
from vprbench.runs.thumbnails import Thumbnails

NORDLAND = {"rows": [*PAPER.rows.values()], "column": PAPER.columns["nordland"]}
COSTS = (draw_rate_tradeoff, draw_memory_tradeoff)
ACCURACY = (draw_precision_recall, draw_recall_at_n, draw_recall_at_tolerance, *COSTS)


@pytest.mark.parametrize("draw", ACCURACY)
def test_a_caption_names_data_seeds_and_tuned_rows_and_that_of_costs_machines_and_disturbed_rows_too(draw):
    tuned = run("mine", 0.5, tuned_on={"dataset": "railway", "places": "the first 9 places"})
    busy = run("gcl", 0.3, notes=(Note("noisy", "two carts passed"),))
    seeds = series("SAD", *(run("sad", seed=seed, device="cuda") for seed in (0, 1)))
    caption = draw([series("Mine", tuned), seeds, series("GCL", busy)]).caption
    assert "railway (40 queries, 50 places)" in caption
    assert "Mine: tuned on the first 9 places of railway" in caption
    assert ("Abacus 9" in caption, "Loom 7" in caption, "laps: GCL." in caption) == (draw in COSTS,) * 3
    assert "SAD 2." in caption


UNTIMED = [series("SAD", little.a_run(timing=None, spikes=None))]


@pytest.mark.parametrize(
    ("draw", "given", "remedy"),
    [
        *((draw, [series("SAD", little.unanswerable_run())], "right place") for draw in ACCURACY),
        (draw_spikes, UNTIMED, "method=vprtempo"),
        (draw_raster, UNTIMED, "method=vprtempo_latencies"),
        (draw_growth, [], "no growth"),
        (draw_growing_map, UNTIMED, "stream=true"),
        (partial(draw_training_time, **NORDLAND), (), "Nordland"),
        (draw_rate_tradeoff, UNTIMED, "timing=quick"),
        (partial(draw_query_rate, **NORDLAND), UNTIMED, "Nordland .*timing=quick"),
        (partial(draw_frames, title="Railway"), Thumbnails((), (), (), (), ()), "Railway"),
        (partial(draw_similarity, name="SAD"), little.a_run(scores=None), "little on journey .*4 queries x 10 places"),
    ],
)
def test_what_cannot_be_drawn_is_refused_by_name(draw, given, remedy):
    with pytest.raises(BadInput, match=remedy):
        draw(given)
