"""Captions name data, seeds and machines; a figure without anything to draw is refused by name."""

from dataclasses import replace
from functools import partial

import little
import numpy as np
import pytest
from checkout import ROOT
from figure_runs import five_rows, run, series, sized

from vprbench.errors import BadInput
from vprbench.metrics.ranking import outcome
from vprbench.report.figures.accuracy import draw_precision_recall, draw_recall_at_n, draw_recall_at_tolerance
from vprbench.report.figures.growth import draw_growing_map, draw_growth
from vprbench.report.figures.pictures import draw_frames, draw_similarity
from vprbench.report.figures.speed import draw_query_rate, draw_training_time
from vprbench.report.figures.spikes import draw_raster, draw_spikes
from vprbench.report.figures.tradeoff import draw_memory_tradeoff, draw_rate_tradeoff
from vprbench.report.growth import samples
from vprbench.report.plan import Row, read_plan
from vprbench.runs.notes import Note
from vprbench.runs.thumbnails import Thumbnails

PLAN = read_plan(ROOT / "conf" / "table.yaml")
ROWS = list(PLAN.rows.values())
NORDLAND, WINTER = PLAN.columns["nordland"], PLAN.columns["railway_winter"]
UNPUBLISHED = replace(PLAN.columns["railway"], published=None)
COSTS = (draw_rate_tradeoff, draw_memory_tradeoff)
ACCURACY = (draw_precision_recall, draw_recall_at_n, draw_recall_at_tolerance, *COSTS)


def troubled():
    """Return a tuned row, one on a GPU, and one on a busy machine."""
    tuned = run("mine", 0.5, tuned_on={"dataset": "railway", "places": "the first 9 places"})
    busy = run("gcl", 0.3, notes=(Note("noisy", "two carts passed"),))
    return [series("Mine", tuned), series("SAD", run("sad", device="cuda")), series("GCL", busy)]


def unanswered():
    """Return two seeds of which one query has no right place."""
    runs = [little.a_run(config={**little.a_run().config, "seed": seed}) for seed in (0, 1)]
    positives = (*runs[0].positives[:3], np.empty(0, np.int64))
    scores = np.asarray(runs[0].scores)
    return series("VPRTempo", *(replace(r, positives=positives, outcome=outcome(scores, positives)) for r in runs))


@pytest.mark.parametrize("draw", ACCURACY)
def test_a_caption_names_data_seeds_and_tuned_rows_and_that_of_costs_machines_and_disturbed_rows_too(draw):
    caption = draw(troubled()).caption
    assert "railway (40 queries, 50 places)" in caption
    assert "Mine: tuned on the first 9 places of railway" in caption
    assert ("Abacus 9" in caption, "Loom 7" in caption, "laps: GCL." in caption) == (draw in COSTS,) * 3
    caption = draw([unanswered()]).caption
    assert "journey (4 queries, 10 places, 1 without a right place)" in caption
    assert "VPRTempo 2." in caption


def test_a_caption_of_speed_names_the_paper_s_machines_where_it_has_bars_and_the_data_that_stand_in():
    five = five_rows(n_places=50)
    for draw in (draw_training_time, draw_query_rate):
        assert "Intel i7-9700K" in draw(five, ROWS, NORDLAND).caption
        assert "Table II on Oxford RobotCar" in draw(five[-1:], ROWS, WINTER).caption
        assert "i7-9700K" not in draw(troubled()[2:], [Row("GCL", "gcl")], UNPUBLISHED).caption
    assert "quoted there: NetVLAD, GCL." in draw_training_time(five, ROWS, NORDLAND).caption
    assert "VPRSNN match, VPRTempo match." in draw_query_rate(five, ROWS, NORDLAND).caption


def test_a_caption_of_growth_names_the_sizes_of_the_maps():
    row = samples(Row("VPRTempo", "vprtempo", "match"), [sized(n, 0.01 * n, 0.001) for n in (300, 9000)])
    assert "2 maps of 300 to 9,000 places" in draw_growth([row]).caption


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
