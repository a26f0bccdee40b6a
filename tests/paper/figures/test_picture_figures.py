from __future__ import annotations

import little
import numpy as np
import numpy.typing as npt
import preprocess_oracle
import pytest
from figure_runs import run, scores_with_recall
from matplotlib.axes import Axes

from vprbench.api.arrays import Image
from vprbench.metrics.ranking import outcome
from vprbench.paper.figures.pictures import frames, similarity
from vprbench.paper.figures.style import Drawn, pdf
from vprbench.run.record import Run
from vprbench.run.thumbnails import Example, Thumbnails


def picture(seed: int, height: int = 45, width: int = 80) -> Image:
    """A frame with structure on the scale of patches, so that no window is flat."""
    random = np.random.default_rng(seed)
    coarse = random.integers(0, 256, (height // 5, width // 5, 3)).repeat(5, axis=0).repeat(5, axis=1)
    return np.clip(coarse + random.integers(-20, 21, coarse.shape), 0, 255).astype(np.uint8)


def kept(*examples: Example) -> Thumbnails:
    return Thumbnails(
        query_names=tuple(f"summer/{i}.png" for i in range(10)),
        reference_names=tuple(f"spring/{i}.png" for i in range(20)),
        examples=examples,
        queries=(b"",) * 10,
        references=(b"",) * 20,
    )


TWO = kept(Example(0, 5, picture(1), picture(2)), Example(3, 8, picture(3), picture(4)))


def shown(axes: Axes) -> npt.NDArray[np.float64]:
    (image,) = axes.images
    return np.asarray(image.get_array())


def matrices(drawn: Drawn) -> tuple[Axes, Axes]:
    """The panels of the ground truth and of the scores, without the colour bar."""
    truth, scores, _ = drawn.figure.axes
    return truth, scores


def with_scores(scores: npt.ArrayLike, *right: list[int]) -> Run:
    matrix = np.asarray(scores, np.float32)
    positives = tuple(np.array(row, np.int64) for row in right)
    return little.a_run(scores=matrix, positives=positives, outcome=outcome(matrix, positives))


def test_a_row_shows_the_right_place_and_the_query_as_they_are() -> None:
    axes = frames(TWO, "Railway").figure.axes
    assert len(axes) == 8
    for row, example in enumerate(TWO.examples):
        assert np.array_equal(shown(axes[4 * row]), example.reference_image)
        assert np.array_equal(shown(axes[4 * row + 1]), example.query_image)
    titles = [panel.get_title(loc="left").replace("\n", " ") for panel in axes[:4]]
    assert titles == ["Reference", "Query", "Reference, normalised", "Query, normalised"]
    assert [axes[0].get_ylabel(), axes[4].get_ylabel()] == ["Place 5\nquery 0", "Place 8\nquery 3"]


def test_beside_them_stand_their_patch_normalised_versions() -> None:
    axes = frames(TWO, "Railway").figure.axes
    for panel, image in zip(axes[2:4], (TWO.examples[0].reference_image, TWO.examples[0].query_image), strict=True):
        grey = preprocess_oracle.gamma_c(preprocess_oracle.grey_c(image))
        slow = preprocess_oracle.patch_normalise(preprocess_oracle.resize_bilinear(grey, 28, 28), 7, 1)
        assert shown(panel).shape == (28, 28)
        np.testing.assert_allclose(shown(panel), slow, atol=1)  # float32 against float64 moves a truncated level
        assert panel.images[0].get_clim() == (0, 255)


@pytest.mark.parametrize(("height", "width"), [(32, 64), (360, 640), (320, 180), (100, 640)])
def test_frames_of_any_shape_fit_the_page_and_have_one_height(height: int, width: int) -> None:
    example = Example(0, 5, picture(1, height, width), picture(2, height, width))
    figure = frames(kept(example, example), "Railway").figure
    figure.draw_without_rendering()
    assert figure.get_figwidth() * 25.4 <= 180.001
    boxes = [panel.get_position() for panel in figure.axes]
    heights = [box.height * figure.get_figheight() * 25.4 for box in boxes]
    assert min(heights) > 10  # mm
    for panel, box in zip(figure.axes, boxes, strict=True):
        rows, columns = shown(panel).shape[:2]
        drawn = box.width * figure.get_figwidth() / (box.height * figure.get_figheight())
        assert drawn == pytest.approx(columns / rows, rel=0.02)


def test_the_ground_truth_has_a_dark_cell_for_each_right_place_and_none_else() -> None:
    truth, scores = matrices(similarity(with_scores(np.eye(3, 5), [1], [0, 4], []), "VPRTempo, five networks"))
    assert shown(truth).tolist() == [[0, 1, 0, 0, 0], [1, 0, 0, 0, 1], [0, 0, 0, 0, 0]]
    assert (truth.get_xlabel(), truth.get_ylabel()) == ("Place", "Query")
    assert scores.get_title(loc="left") == "Similarity, VPRTempo, five networks"


def test_the_scores_of_each_query_run_from_0_to_1() -> None:
    """A place that is no candidate is drawn as the worst."""
    no = -np.inf
    given = np.array([[10, 20, 30, 15], [-5, -4, -1, -5], [7, 7, 7, 7], [no, 2, 4, 3], [no] * 4], np.float32)
    made = with_scores(given, [0], [1], [2], [0], [1])
    _, scores = matrices(similarity(made))
    stretched = [[0, 0.5, 1, 0.25], [0, 0.25, 1, 0], [0, 0, 0, 0], [0, 0, 1, 0.5], [0, 0, 0, 0]]
    np.testing.assert_allclose(shown(scores), stretched)
    np.testing.assert_array_equal(made.scores, given)


def test_cells_of_a_large_matrix_are_the_maxima_of_blocks_and_stand_at_their_numbers() -> None:
    """1000 places need blocks of 3, and neither 1000 nor 20 is a multiple of 3."""
    made = run(n_queries=20, n_places=1000)
    truth, scores = matrices(similarity(made))
    assert made.scores is not None
    low, high = made.scores.min(1, keepdims=True), made.scores.max(1, keepdims=True)
    stretched = (made.scores - low) / (high - low)
    assert shown(scores).shape == shown(truth).shape == (7, 334)
    for row in range(7):
        for column in range(334):
            block = np.s_[3 * row : 3 * row + 3, 3 * column : 3 * column + 3]
            assert shown(scores)[row, column] == pytest.approx(stretched[block].max())
            queries = range(3 * row, min(3 * row + 3, 20))
            assert shown(truth)[row, column] == any(query // 3 == column for query in queries)
    for panel in (truth, scores):
        assert panel.images[0].get_extent() == [-0.5, 1001.5, 20.5, -0.5]  # 334 x 3 places, 7 x 3 queries
        assert panel.get_xlim() == (-0.5, 999.5)
        assert panel.get_ylim() == (19.5, -0.5)  # the first query on top


def test_at_the_size_of_nordland_no_right_place_vanishes_and_the_file_stays_small() -> None:
    matrix = np.roll(scores_with_recall(1.0, 2700, 3300), 600, axis=1)
    drawn = similarity(with_scores(matrix, *([query + 600] for query in range(2700))))
    truth, scores = matrices(drawn)
    rows, columns = np.arange(2700) // 8, (np.arange(2700) + 600) // 8
    assert shown(truth)[rows, columns].min() == 1
    assert shown(scores)[rows, columns].min() == 1
    assert shown(truth).sum() == len({*zip(rows.tolist(), columns.tolist(), strict=True)})
    assert len(pdf(drawn)) < 500_000


@pytest.mark.parametrize(("n_queries", "n_places"), [(4, 400), (400, 4), (1, 1)])
def test_a_matrix_that_is_far_from_square_still_has_a_height_to_see(n_queries: int, n_places: int) -> None:
    figure = similarity(with_scores(np.ones((n_queries, n_places)), *([0] for _ in range(n_queries)))).figure
    figure.draw_without_rendering()
    for panel in figure.axes[:2]:
        box = panel.get_position()
        assert 20 < box.height * figure.get_figheight() * 25.4 < 90
        assert 20 < box.width * figure.get_figwidth() * 25.4 < 90
