"""Captions name data, seeds and machines; a figure without anything to draw is refused by name."""

from dataclasses import replace
from functools import partial

import little
import pytest
from checkout import ROOT
from figure_runs import run, series

from vprbench.errors import BadInput
from vprbench.report.figures.accuracy import draw_precision_recall, draw_recall_at_n, draw_recall_at_tolerance
from vprbench.report.figures.growth import draw_growing_map, draw_growth
from vprbench.report.figures.pictures import draw_frames, draw_similarity
from vprbench.report.figures.speed import draw_query_rate, draw_training_time
from vprbench.report.figures.spikes import draw_raster, draw_spikes
from vprbench.report.figures.tradeoff import draw_memory_tradeoff, draw_rate_tradeoff
from vprbench.report.plan import Row, read_plan
from vprbench.runs.notes import Note
from vprbench.runs.thumbnails import Thumbnails

PLAN = read_plan(ROOT / "conf" / "paper" / "table2.yaml")
ROWS = list(PLAN.rows.values())
NORDLAND, WINTER = PLAN.columns["nordland"], PLAN.columns["railway_winter"]
UNPUBLISHED = replace(PLAN.columns["railway"], published=None)
COSTS = (draw_rate_tradeoff, draw_memory_tradeoff)
ACCURACY = (draw_precision_recall, draw_recall_at_n, draw_recall_at_tolerance, *COSTS)


def troubled():
    """Return a tuned row, two seeds on a GPU, and a row on a busy machine."""
    tuned = run("mine", 0.5, tuned_on={"dataset": "railway", "places": "the first 9 places"})
    busy = run("gcl", 0.3, notes=(Note("noisy", "two carts passed"),))
    seeds = series("SAD", *(run("sad", seed=seed, device="cuda") for seed in (0, 1)))
    return [series("Mine", tuned), seeds, series("GCL", busy)]


@pytest.mark.parametrize("draw", ACCURACY)
def test_a_caption_names_data_seeds_and_tuned_rows_and_that_of_costs_machines_and_disturbed_rows_too(draw):
    caption = draw(troubled()).caption
    assert "railway (40 queries, 50 places)" in caption
    assert "Mine: tuned on the first 9 places of railway" in caption
    assert ("Abacus 9" in caption, "Loom 7" in caption, "laps: GCL." in caption) == (draw in COSTS,) * 3
    assert "SAD 2." in caption


@pytest.mark.parametrize(
    ("draw", "words"),
    [(draw_training_time, "quoted there: NetVLAD, GCL."), (draw_query_rate, "VPRSNN match, VPRTempo match.")],
)
def test_a_caption_of_speed_names_the_paper_s_machines_where_it_has_bars_and_the_data_that_stand_in(draw, words):
    caption = draw(troubled(), ROWS, WINTER, PLAN.published).caption
    assert "Table II on Oxford RobotCar" in caption
    assert "Intel i7-9700K" in caption
    assert words in caption
    assert "i7-9700K" not in draw(troubled(), [Row("GCL", "gcl")], UNPUBLISHED, PLAN.published).caption


UNTIMED = [series("SAD", little.a_run(timing=None, spikes=None))]
UNANSWERABLE = [series("SAD", little.unanswerable_run())]


@pytest.mark.parametrize(
    ("draw", "given", "remedy"),
    [
        *((draw, UNANSWERABLE, "right place") for draw in ACCURACY),
        (draw_spikes, UNTIMED, "method=vprtempo"),
        (draw_raster, UNTIMED, "method=vprtempo_latencies"),
        (draw_growth, [], "no growth"),
        (draw_growing_map, UNTIMED, "stream=true"),
        (partial(draw_training_time, rows=ROWS, column=NORDLAND), (), "Nordland"),
        (draw_rate_tradeoff, UNTIMED, "timing=quick"),
        (partial(draw_query_rate, rows=ROWS, column=NORDLAND), UNTIMED, "Nordland .*timing=quick"),
        (partial(draw_frames, title="Railway"), Thumbnails((), (), (), (), ()), "Railway"),
        (partial(draw_similarity, name="SAD"), little.a_run(scores=None), "little on journey .*4 queries x 10 places"),
    ],
)
def test_what_cannot_be_drawn_is_refused_by_name(draw, given, remedy):
    with pytest.raises(BadInput, match=remedy):
        draw(given)
