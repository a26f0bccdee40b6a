"""What methods see and what they answer: frames with their patch-normalised versions, and a similarity matrix."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vprbench.api.arrays import Image, Scores
from vprbench.api.images import Images
from vprbench.errors import BadInput
from vprbench.report.figures.captions import describe_runs
from vprbench.report.figures.style import DOUBLE_MM, Drawing, new_figure, use_style
from vprbench.report.selection import MethodRuns
from vprbench.runs.record import Run
from vprbench.runs.thumbnails import Thumbnails

_SIDE = 28  # pixels of a patch-normalised frame
_PATCH = 7
_NARROWEST = 0.7  # of a frame's height, for the title of its column
_FRAME_MM = 28.0  # highest row of frames
_MARGIN_MM = 12.0  # for titles and labels
_MOST_CELLS = 450  # along a side of a drawn matrix: each is still visible in print
_PANEL_MM = 72.0  # longest side of a drawn matrix
_FLATTEST = 0.4  # shorter over longer side of one


@use_style
def draw_frames(thumbnails: Thumbnails, title: str) -> Drawing:
    """Draw the kept examples, right place and query, as they are and patch-normalised.

    `title` names the dataset. The right half is VPRTempo's input: 28 x 28 pixels, patches of 7 x 7 (its public code,
    64154e5). Raises BadInput if no example is kept.
    """
    examples = thumbnails.examples
    if not examples:
        raise BadInput(f"no example frames of {title} are kept: a query needs a right place to be shown beside it")
    references = [example.reference_image for example in examples]
    queries = [example.query_image for example in examples]
    columns = {
        "Reference": references,
        "Query": queries,
        "Reference,\nnormalised": _normalise_patches(references),
        "Query,\nnormalised": _normalise_patches(queries),
    }
    widths = [max(_NARROWEST, *(image.shape[1] / image.shape[0] for image in images)) for images in columns.values()]
    height = min(_FRAME_MM, (DOUBLE_MM - _MARGIN_MM) / sum(widths))
    width = min(DOUBLE_MM, height * sum(widths) + 2 * _MARGIN_MM)
    figure, axes = new_figure(width, height * len(examples) + _MARGIN_MM, len(examples), len(columns))
    grid = axes[0].get_gridspec()
    assert grid is not None  # subplots always have one
    grid.set_width_ratios(widths)
    for column, (name, images) in enumerate(columns.items()):
        for panel, image in zip(axes[column :: len(columns)], images, strict=True):
            panel.imshow(image, cmap="gray", vmin=0, vmax=255, interpolation="nearest" if column > 1 else "antialiased")
            panel.set(xticks=[], yticks=[])
            panel.spines[:].set_visible(False)
        axes[column].set_title(name)
    for panel, example in zip(axes[:: len(columns)], examples, strict=True):
        panel.set_ylabel(f"Place {example.place}\nquery {example.query}")
    places, asked = thumbnails.reference_names, thumbnails.query_names
    pairs = [f"{places[example.place]} and {asked[example.query]}" for example in examples]
    caption = (
        f"Places of {title}, each with a query that shows it. Left: as stored. Right: VPRTempo's input, grey, "
        f"gamma-corrected, {_SIDE} x {_SIDE} pixels, normalised in patches of {_PATCH} x {_PATCH}. "
        f"From top to bottom: {'; '.join(pairs)}."
    )
    return Drawing(figure, caption)


@use_style
def draw_similarity(run: Run, name: str) -> Drawing:
    """Draw the ground truth beside the scores of all places for all queries.

    `name` is the row's, as in the table. The scores of each query are stretched from its worst candidate, 0, to its
    best, 1. A large matrix is drawn as the maxima of blocks, so that no right place vanishes. Raises BadInput if the
    run did not keep its scores.
    """
    if run.scores is None:
        raise BadInput(
            f"run {run.key} of {run.method} on {run.dataset} did not keep its scores ({len(run.outcome):,} queries x "
            f"{run.outcome.n_places:,} places): draw a run on a smaller dataset, and one view alone"
        )
    n_queries, n_places = run.scores.shape
    truth = np.zeros(run.scores.shape, np.float32)
    for query, right in enumerate(run.positives):
        truth[query, right] = 1
    longest = max(n_queries, n_places)
    block = -(-longest // _MOST_CELLS)
    height = max(n_queries / longest, _FLATTEST) * _PANEL_MM
    figure, panels = new_figure(DOUBLE_MM, height + _MARGIN_MM, columns=2)
    matrices = {"Ground truth": truth, f"Similarity, {name}": _stretch_scores(run.scores)}
    for axes, (heading, matrix) in zip(panels, matrices.items(), strict=True):
        cells = _compute_block_maxima(matrix, block)
        bottom, right = (block * count - 0.5 for count in cells.shape)
        image = axes.imshow(
            cells,
            cmap="gray_r",
            vmin=0,
            vmax=1,
            interpolation="none",  # the cells themselves go into a PDF, whatever its resolution
            extent=(-0.5, right, bottom, -0.5),  # ticks are numbers of queries and places
            aspect="equal" if min(n_queries, n_places) >= _FLATTEST * longest else "auto",
        )
        axes.set(xlabel="Place", ylabel="Query", xlim=(-0.5, n_places - 0.5), ylim=(n_queries - 0.5, -0.5))
        axes.set_title(heading)
        axes.spines[:].set_visible(True)
    figure.colorbar(image, ax=panels[1], label="Score within its query", ticks=[0, 0.5, 1], aspect=30)
    caption = (
        f"Ground truth (left) and scores of {name}, seed {run.config['seed']} (right); rows are queries, columns are "
        "places. Scores of each query run from 0, its worst place, to 1, its best. "
        f"{f'A cell is the maximum of {block} x {block} scores. ' if block > 1 else ''}"
        f"{describe_runs([MethodRuns(name, (run,))])}"
    )
    return Drawing(figure, caption)


def _stretch_scores(scores: Scores) -> Scores:
    """Return scores from 0 to 1 within each query; 0 if a place is no candidate or all scores are alike."""
    candidate = scores > -np.inf
    best = scores.max(axis=1, keepdims=True)
    worst = np.where(candidate, scores, np.inf).min(axis=1, keepdims=True)
    stretched = np.zeros_like(scores)
    np.divide(scores - worst, best - worst, out=stretched, where=candidate & (best > worst))
    return stretched


def _compute_block_maxima(matrix: Scores, block: int) -> Scores:
    """Return the maximum of each block of `block` x `block` cells; those at the end may be smaller."""
    rows, columns = (np.arange(0, count, block) for count in matrix.shape)
    return np.maximum.reduceat(np.maximum.reduceat(matrix, rows, axis=0), columns, axis=1)


def _normalise_patches(images: Sequence[Image]) -> list[Image]:
    # A plug-in of this project, which type checkers find as `methods`; it brings PyTorch.
    from vprbench.methods.parts.filters.patches import PatchNormalisation  # type: ignore[import-not-found]

    levels = PatchNormalisation("C", _SIDE, _SIDE, _PATCH)(Images.from_arrays(images))
    return list(levels.reshape(-1, _SIDE, _SIDE))
