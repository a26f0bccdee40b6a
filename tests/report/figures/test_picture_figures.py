"""Frames, matrices and spikes are drawn as they were stored, none of them lost."""

import little
import numpy as np
import preprocess_oracle
import pytest
from figure_runs import run, series
from matplotlib.patches import Rectangle

from vprbench.report.figures.pictures import draw_frames, draw_similarity
from vprbench.report.figures.spikes import draw_spikes
from vprbench.runs.thumbnails import Example, Thumbnails


def picture(seed, height=45, width=80):
    """A frame with structure on the scale of patches, so that no window is flat."""
    random = np.random.default_rng(seed)
    coarse = random.integers(0, 256, (height // 5, width // 5, 3)).repeat(5, axis=0).repeat(5, axis=1)
    return np.clip(coarse + random.integers(-20, 21, coarse.shape), 0, 255).astype(np.uint8)


def shown(axes):
    (image,) = axes.images
    return np.asarray(image.get_array())


def test_a_row_shows_the_right_place_and_the_query_as_they_are_and_patch_normalised():
    first, second = Example(0, 1, picture(1), picture(2)), Example(1, 0, picture(3), picture(4))
    names = {"query_names": ("q0.png", "q1.png"), "reference_names": ("r0.png", "r1.png")}
    drawn = draw_frames(Thumbnails(**names, examples=(first, second), queries=(), references=()), "Railway")
    axes = drawn.figure.axes
    for row, example in enumerate((first, second)):
        images = example.reference_image, example.query_image
        for panel, normalised, image in zip(axes[4 * row :], axes[4 * row + 2 :], images, strict=False):
            assert np.array_equal(shown(panel), image)
            grey = preprocess_oracle.gamma_c(preprocess_oracle.grey_c(image))
            slow = preprocess_oracle.patch_normalise(preprocess_oracle.resize_bilinear(grey, 28, 28), 7, 1)
            np.testing.assert_allclose(shown(normalised), slow, atol=1)  # float32 moves a truncated level
    assert [axes[0].get_ylabel(), axes[4].get_ylabel()] == ["Place 1\nquery 0", "Place 0\nquery 1"]
    assert "r1.png and q0.png; r0.png and q1.png" in drawn.caption


def test_right_places_are_dark_and_the_scores_of_each_query_run_from_0_to_1():
    no = -np.inf  # no candidate is drawn as the worst
    given = np.array([[10, 20, 30, 15], [-5, -4, -1, -5], [7, 7, 7, 7], [no, 2, 4, 3], [no] * 4], np.float32)
    made = little.answered(given, [[1], [0, 3], [], [0], [1]])
    truth, scores, _ = draw_similarity(made, "VPRTempo, five networks").figure.axes
    assert shown(truth).tolist() == [[0, 1, 0, 0], [1, 0, 0, 1], [0, 0, 0, 0], [1, 0, 0, 0], [0, 1, 0, 0]]
    stretched = [[0, 0.5, 1, 0.25], [0, 0.25, 1, 0], [0, 0, 0, 0], [0, 0, 1, 0.5], [0, 0, 0, 0]]
    np.testing.assert_allclose(shown(scores), stretched)
    np.testing.assert_array_equal(made.scores, given)
    assert (truth.get_xlabel(), truth.get_ylabel()) == ("Place", "Query")
    assert scores.get_title(loc="left") == "Similarity, VPRTempo, five networks"


def test_cells_of_a_large_matrix_are_the_maxima_of_blocks_so_that_no_right_place_vanishes():
    """1000 places need blocks of 3, and neither 1000 nor 20 is a multiple of 3."""
    made = run(n_queries=20, n_places=1000)
    truth, scores, _ = draw_similarity(made, "SAD").figure.axes
    low, high = made.scores.min(1, keepdims=True), made.scores.max(1, keepdims=True)
    padded = np.zeros((21, 1002))
    padded[:20, :1000] = (made.scores - low) / (high - low)
    np.testing.assert_allclose(shown(scores), padded.reshape(7, 3, 334, 3).max((1, 3)))
    assert shown(truth).tolist() == np.eye(7, 334).tolist()  # query q is of place q
    for panel in (truth, scores):
        assert panel.images[0].get_extent() == [-0.5, 1001.5, 20.5, -0.5]  # 334 x 3 places, 7 x 3 queries
        assert (panel.get_xlim(), panel.get_ylim()) == ((-0.5, 999.5), (19.5, -0.5))  # the first query on top


def spiking(name, *seeds):
    """Return a row with a run for each seed, of the layers of its network."""
    kept = [{"queries": len(layers[0]["spikes_per_query"]), "layers": list(layers)} for layers in seeds]
    return series(name, *(little.a_run(spikes=spikes) for spikes in kept))


def layer(name, spikes, active_share=0.5, neurons=100):
    return little.a_layer(name, neurons, list(spikes), active_share, None)


def medians(axes):
    """The heights of black lines: a box has one, at its median."""
    return [float(np.asarray(line.get_ydata())[0]) for line in axes.lines if line.get_color() == "black"]


def bars(axes):
    return [patch.get_height() for patch in axes.patches if isinstance(patch, Rectangle)]


def test_each_layer_has_a_box_of_the_middle_half_of_its_queries_with_whiskers():
    axes, _ = draw_spikes([spiking("VPRTempo", [layer("output", range(100, 201))])]).figure.axes
    heights = axes.patches[0].get_path().vertices[:, 1]
    assert (heights[:4].min(), heights[:4].max()) == (125, 175)
    ends = np.concatenate([np.asarray(line.get_ydata()) for line in axes.lines])
    assert (ends.min(), ends.max()) == (105, 195)


def test_seeds_share_a_box_with_a_dot_each_at_the_bar_and_rows_with_spikes_stand_side_by_side():
    seeds = [layer("output", [10, 10], 0.2)], [layer("output", [14, 16], 0.4)]
    axes, active = draw_spikes([spiking("VPRTempo", *seeds)]).figure.axes
    assert medians(axes) == [12]  # of 10, 10, 14, 16
    assert bars(active) == pytest.approx([30])
    (dots,) = active.lines
    assert np.asarray(dots.get_ydata()).tolist() == [20, 40]
    snn = spiking("VPRSNN", [layer("inhibitory", [5, 6, 7]), layer("output", [50, 60, 70], 0.75)])
    tempo = spiking("VPRTempo", [layer("input", [700, 710, 690], 1, 784), layer("output", [20, 30, 25], 0.25, 300)])
    drawn = draw_spikes([series("SAD", little.a_run(spikes=None)), snn, tempo])
    *layers, active = drawn.figure.axes
    titles = [axes.get_title(loc="left") for axes in layers]
    assert titles == ["inhibitory,\n100 neurons", "output,\n100/300 neurons", "input,\n784 neurons"]
    assert [medians(axes) for axes in layers] == [[6], [60, 25], [700]]
    assert sorted(bars(active)) == [25, 50, 75, 100]
    assert [text.get_text() for text in drawn.figure.legends[0].get_texts()] == ["VPRSNN", "VPRTempo"]
    assert len({patch.get_hatch() for patch in layers[1].patches}) == 2
