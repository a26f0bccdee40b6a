"""Figures read in grey and are the same bytes for the same data; captions name these; nothing to draw is refused."""

import itertools
from functools import partial

import little
import matplotlib
import numpy as np
import pytest
from figure_runs import run, series
from matplotlib.colors import to_rgb
from PIL import Image
from stored_runs import PAPER

from vprbench.errors import BadInput
from vprbench.report.figures.accuracy import draw_precision_recall, draw_recall_at_n, draw_recall_at_tolerance
from vprbench.report.figures.growth import draw_growing_map, draw_growth
from vprbench.report.figures.make import write_figures
from vprbench.report.figures.pictures import draw_frames, draw_similarity
from vprbench.report.figures.speed import draw_query_rate, draw_training_time
from vprbench.report.figures.spikes import draw_raster, draw_spikes
from vprbench.report.figures.style import SINGLE_MM, Drawing, choose_looks, new_figure, scale_log, use_style
from vprbench.report.figures.tradeoff import draw_memory_tradeoff, draw_rate_tradeoff
from vprbench.runs.notes import Note
from vprbench.runs.thumbnails import Thumbnails
from vprbench.text import format_three_digits

NAMES = ["SAD", "NetVLAD", "GCL", "VPRSNN", "VPRTempo"]


def lightness(colour):
    """Return CIE L*, 0 to 100, of an sRGB colour."""
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in to_rgb(colour)]
    return 116 * float(np.cbrt(np.dot(linear, [0.2126, 0.7152, 0.0722]))) - 16


@use_style
def drawing():
    figure, (axes,) = new_figure(SINGLE_MM, 60)
    axes.plot([1, 2, 3], [4, 6, 5], label="ünïcode")
    axes.bar([1, 2], [1, 2], hatch="//")
    axes.legend()
    return Drawing(figure, "Three points of <script>a *made-up* method</script>, with “quotes”.")


def test_any_two_methods_of_a_figure_look_different_and_those_of_the_paper_the_same_everywhere():
    rows = [*choose_looks(NAMES).values()]
    assert min(abs(lightness(a.colour) - lightness(b.colour)) for a, b in itertools.pairwise(rows)) > 12
    many = [*choose_looks([f"method {i}" for i in range(360)]).values()]
    assert len({(look.colour, look.marker, look.dash) for look in many}) == 360
    for part in ("colour", "marker", "dash", "hatch"):
        assert len({getattr(look, part) for look in many[:8]}) == 8
        assert len({getattr(look, part) for look in rows}) == len(NAMES)
    assert choose_looks([*NAMES, "cosplace", "mixvpr"])["mixvpr"] == choose_looks(["cosplace", "mixvpr"])["mixvpr"]


@pytest.mark.extended
def test_a_figure_has_its_width_and_the_same_bytes_whatever_a_reader_set_and_its_caption_is_no_markup(tmp_path):
    pdf, captions = write_figures({"three": drawing()}, tmp_path)
    written = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert {*written} == {pdf.name, captions.name, "three.png"} == {"three.pdf", "captions.md", "three.png"}
    assert b"&lt;script&gt;a \\*made-up\\* method&lt;/script&gt;" in written["captions.md"]
    assert b"Date" not in written["three.pdf"]
    with Image.open(tmp_path / "three.png") as image:
        assert image.width == pytest.approx(88 / 25.4 * 300, abs=1)
        assert image.info["Description"] == drawing().caption
    box = written["three.pdf"].split(b"/MediaBox [")[1].split(b"]")[0].split()
    assert float(box[2]) == pytest.approx(88 / 25.4 * 72, abs=1)
    settings = dict(matplotlib.rcParams)
    with matplotlib.rc_context({"font.size": 20, "axes.facecolor": "black", "savefig.dpi": 50}):
        assert [*write_figures({"three": drawing()}, tmp_path)] == [pdf, captions]
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == written
    assert dict(matplotlib.rcParams) == settings


def test_numbers_are_written_to_three_digits_without_powers_of_ten_on_an_axis_that_holds_all_values():
    numbers = {15120: "15,120", 353: "353", 99.96: "100", 0.5: "0.5", 1.666: "1.67", 0.00123: "0.00123", 20: "20"}
    assert {value: format_three_digits(value) for value in numbers} == numbers
    for values in ([0.01, 3e6], [3.0, 3.1], [0.02, 0.9]):
        figure, (axes,) = new_figure(SINGLE_MM, 60)
        scale_log(axes, "x", values)
        figure.draw_without_rendering()
        low, high = axes.get_xlim()
        assert low < min(values) <= max(values) < high
        assert sum(low <= tick <= high for tick in axes.xaxis.get_majorticklocs()) >= 2


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
    assert ("Abacus 9" in caption, "Loom 3" in caption, "laps: GCL." in caption) == (draw in COSTS,) * 3
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
