from __future__ import annotations

import numpy as np
import pytest
from little import a_run
from matplotlib.lines import Line2D

from vprbench.errors import BadInput
from vprbench.metrics.ranking import outcome, ranked_places
from vprbench.paper.figures.sequences import recall_at_length
from vprbench.paper.selection import Series
from vprbench.run.record import Run
from vprbench.run.sequences import views

N = 30


def noisy(seed: int) -> Run:
    """A run whose query i shows place i, hidden by noise from a seed."""
    scores = np.random.default_rng(seed).normal(size=(N, N)).astype(np.float32) + np.eye(N, dtype=np.float32)
    positives = tuple(np.array([place]) for place in range(N))
    places, values = ranked_places(scores, 5)
    ranked = {"outcome": outcome(scores, positives), "top_places": places, "top_scores": values}
    return a_run(positives=positives, scores=scores, **ranked)


def test_each_row_has_its_recall_at_each_length_and_the_caption_counts_the_queries() -> None:
    rows = {"first": [noisy(0), noisy(1)], "second": [noisy(2)]}
    seen = dict(zip((1, 2, 5), views([1, 2, 5]), strict=True))
    shown = [
        [Series(name, False, tuple(map(view, runs))) for name, runs in rows.items()]
        for view in reversed(seen.values())  # in any order
    ]
    drawn = recall_at_length(shown)
    (axes,) = drawn.figure.axes
    lines: dict[str, Line2D] = {str(line.get_label()): line for line in axes.lines}
    for name, runs in rows.items():
        wanted = []
        for length in seen:  # by hand: the window's last query, of sums along the diagonal
            right = [
                int(np.argmax([sum(run.scores[q - k, p - k] for k in range(length)) for p in range(length - 1, N)]))
                == q - length + 1
                for run in runs
                if run.scores is not None
                for q in range(length - 1, N)
            ]
            wanted.append(100 * np.mean(right))
        np.testing.assert_allclose(np.asarray(lines[name].get_xdata()), [*seen])
        np.testing.assert_allclose(np.asarray(lines[name].get_ydata()), wanted)
    assert "there are 30 at 1, 29 at 2, 26 at 5" in drawn.caption
    assert "ends with the query" in drawn.caption


def test_one_length_is_no_figure_and_names_what_is_wanted() -> None:
    with pytest.raises(BadInput, match="two lengths"):
        recall_at_length([[Series("first", False, (views(2)[0](noisy(0)),))]])
