from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import figure_runs
import pytest
from checkout import ROOT
from matplotlib.axes import Axes
from matplotlib.colors import to_hex

from vprbench.paper.figures.speed import query_rate, training_time
from vprbench.paper.figures.style import Drawn, looks
from vprbench.paper.plan import Quantity, Row, read_plan
from vprbench.paper.selection import Series

PLAN = read_plan(ROOT / "conf" / "table.yaml")
ROWS = list(PLAN.rows.values())
NORDLAND, STREET = PLAN.columns["nordland"], PLAN.columns["street"]
UNPUBLISHED = replace(PLAN.columns["railway"], title="Railway (rendered), 225 places", published=None)


def tempo(*runs_of_seeds: float, device: str = "cpu") -> Series:
    """Return VPRTempo with a run for each number of minutes of training; the n-th matches in n ms and encodes in 1."""
    runs = [
        figure_runs.run("vprtempo", seed=i, fit_seconds=60 * minutes, match_seconds=0.001 * (i + 1), device=device)
        for i, minutes in enumerate(runs_of_seeds)
    ]
    return figure_runs.series("VPRTempo", *runs, spiking=True)


def bars(axes: Axes, hatched: bool) -> dict[int, float]:
    """Return the number at the end of each bar, by the row at which it stands."""
    found = [bar for bar in axes.patches if bool(bar.get_hatch()) == hatched]
    return {round(bar.get_y() + bar.get_height() / 2): bar.get_x() + bar.get_width() for bar in found}


def words(axes: Axes) -> list[str]:
    return [text.get_text() for text in axes.texts]


def keys(drawn: Drawn) -> list[str]:
    return [text.get_text() for legend in drawn.figure.legends for text in legend.get_texts()]


def black_lines(axes: Axes) -> list[tuple[Sequence[float], Sequence[float]]]:
    return [(list(line.get_xdata()), list(line.get_ydata())) for line in axes.lines if line.get_color() == "black"]


def test_training_bars_end_at_the_measured_and_the_published_minutes() -> None:
    netvlad = figure_runs.series("NetVLAD", figure_runs.run("netvlad", fit_seconds=6000.0))  # comes trained
    drawn = training_time([tempo(3.0), netvlad], (), ROWS, NORDLAND, {})
    (axes,) = drawn.figure.axes
    assert bars(axes, hatched=False) == {4: pytest.approx(3.0)}
    assert bars(axes, hatched=True) == {1: pytest.approx(15120), 2: pytest.approx(360), 3: pytest.approx(360), 4: 60}
    assert [x[0] == x[1] for x, _ in black_lines(axes)] == [True]  # the tick alone: nobody saw a spread
    (measured,) = (bar for bar in axes.patches if not bar.get_hatch())
    assert to_hex(measured.get_facecolor()) == looks(["VPRTempo"])["VPRTempo"].colour.lower()
    hatches = {round(bar.get_y() + 0.19): bar.get_hatch() for bar in axes.patches if bar.get_hatch()}
    assert hatches[1] == hatches[2] != hatches[3] == hatches[4]  # quoted ones have their own
    assert keys(drawn) == ["measured here", "published", "published, quoted there", "with reading the images"]


def test_training_is_drawn_without_waiting_for_images_and_a_tick_with_it() -> None:
    runs = [
        figure_runs.run("vprtempo", seed=i, fit_seconds=wall, fit_compute_seconds=own)
        for i, (wall, own) in enumerate([(600.0, 60.0), (660.0, 120.0), (900.0, 240.0)])
    ]
    drawn = training_time([figure_runs.series("VPRTempo", *runs)], (), ROWS, NORDLAND, {})
    (axes,) = drawn.figure.axes
    assert bars(axes, hatched=False)[4] == pytest.approx(2.0)
    assert [list(x) for x, _ in black_lines(axes)] == [pytest.approx([1, 4]), pytest.approx([11, 11])]
    assert "with reading the images" in keys(drawn)
    drawn.figure.draw_without_rendering()
    (number,) = (text for text in axes.texts if text.get_text() == "2 (11)")
    assert number.get_window_extent().x0 > axes.transData.transform((11, 0))[0]


def test_rates_are_of_encode_and_match_together_beside_the_paper_s() -> None:
    netvlad = figure_runs.series("NetVLAD", figure_runs.run("netvlad", encode_seconds=0.5, match_seconds=0.1))
    sad = figure_runs.series("SAD", figure_runs.run("sad", encode_seconds=0.001, match_seconds=0.004))
    for column, rates in ((NORDLAND, [10, 0.5, 2, 2, 353]), (STREET, [185, 0.5, 0.4, 2, 1670])):
        (axes,) = query_rate([sad, netvlad], (), ROWS, column, {}).figure.axes
        assert bars(axes, hatched=False) == {0: pytest.approx(200), 1: pytest.approx(1 / 0.6)}
        assert [bars(axes, hatched=True)[i] for i in range(5)] == pytest.approx(rates)


def test_a_single_seed_s_rate_shows_the_middle_four_fifths_of_its_laps() -> None:
    run = figure_runs.run("vprtempo", match_seconds=0.001, spread=0.2)
    laps = sorted(run.timing.streaming.total_seconds)  # 101 laps: the quantiles 0.1 and 0.9 are laps 11 and 91
    one, several = figure_runs.series("VPRTempo", run), tempo(1.0, 1.0)  # of two seeds: 500 and 333 Hz
    for given, line, bar in ((one, [1 / laps[90], 1 / laps[10]], 500), (several, [1000 / 3, 500], 1250 / 3)):
        (axes,) = query_rate([given], (), ROWS, NORDLAND, {}).figure.axes
        assert black_lines(axes)[0][0] == pytest.approx(line)
        assert bars(axes, hatched=False)[4] == pytest.approx(bar)


def test_a_row_without_a_measured_training_says_why() -> None:
    loaded = figure_runs.series("VPRSNN", figure_runs.run("vprsnn", fit_seconds=None, network={"run": "ab"}))
    marks: dict[tuple[str, Quantity], str] = {("VPRSNN", "train_cpu"): "not run", ("VPRTempo", "train_cpu"): "failed"}
    (axes,) = training_time([loaded], (), ROWS, UNPUBLISHED, marks).figure.axes
    assert words(axes) == ["no training", "comes trained", "comes trained", "network loaded", "failed"]


def test_a_row_without_a_bar_has_the_word_of_the_table_for_its_device() -> None:
    marks: dict[tuple[str, Quantity], str] = {
        ("SAD", "query_cpu"): "failed",
        ("NetVLAD", "query_cpu"): "not there",
        ("GCL", "query_cpu"): "left out",
        ("GCL", "query_gpu"): "unfinished",
        ("VPRTempo", "query_cpu"): "measured",
    }
    untimed = figure_runs.series("VPRSNN", figure_runs.run("vprsnn", timing=None))
    marks["VPRSNN", "query_cpu"] = "not timed"
    drawn = query_rate([untimed, tempo(1.0)], [tempo(1.0, device="cuda")], ROWS, UNPUBLISHED, marks)
    cpu, gpu = drawn.figure.axes
    assert words(cpu)[:4] == ["failed", "not there", "left out", "not timed"]
    assert words(gpu)[:4] == ["not run", "not run", "unfinished", "not run"]


def test_a_gpu_gets_a_panel_of_its_own_on_the_same_scale() -> None:
    drawn = query_rate([tempo(3.0)], [tempo(0.1, device="cuda")], ROWS, NORDLAND, {})
    cpu, gpu = drawn.figure.axes
    assert (cpu.get_title(loc="left"), gpu.get_title(loc="left")) == ("CPU", "GPU")
    assert cpu.get_xlim() == gpu.get_xlim()
    assert bars(gpu, hatched=True)[4] == pytest.approx(1634)
    assert 3 not in bars(gpu, hatched=True)  # the paper has no GPU code of VPRSNN
    (alone,) = training_time((), [tempo(0.1, device="cuda")], ROWS, NORDLAND, {}).figure.axes
    assert alone.get_title(loc="left") == "GPU"


def test_a_column_that_the_paper_does_not_have_shows_measured_bars_alone() -> None:
    drawn = query_rate([tempo(3.0)], (), ROWS, UNPUBLISHED, {})
    assert bars(drawn.figure.axes[0], hatched=True) == {}
    assert keys(drawn) == ["measured here"]
    cosplace = figure_runs.series("CosPlace", figure_runs.run("cosplace", encode_seconds=0.03, match_seconds=0.02))
    drawn = query_rate([cosplace], (), [Row("CosPlace", "cosplace")], UNPUBLISHED, {})  # a row outside the paper
    assert bars(drawn.figure.axes[0], hatched=False) == {0: pytest.approx(20)}


@pytest.mark.parametrize("n_rows", [1, 5])
def test_every_number_stands_inside_the_panel_and_covers_no_other(n_rows: int) -> None:
    drawn = query_rate(figure_runs.five_rows(), figure_runs.five_rows("cuda"), ROWS[-n_rows:], STREET, {})
    drawn.figure.draw_without_rendering()
    for axes in drawn.figure.axes:
        boxes = [text.get_window_extent() for text in axes.texts]
        assert all(box.x1 <= axes.bbox.x1 for box in boxes)
        assert not any(one.overlaps(other) for i, one in enumerate(boxes) for other in boxes[:i])
