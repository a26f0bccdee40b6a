"""SAD on real frames: the rates and intervals that other code measured."""

import numpy as np
import pytest
from checkout import SHARED
from corridor import needs_corridor, right, scored

from vprbench.datasets.nordland import nordland
from vprbench.methods.sad import SAD
from vprbench.metrics.intervals import block_bootstrap, share_interval


@pytest.fixture(scope="module")
def ranks() -> np.ndarray:
    """How many places score above the right one, for each query of nordland_64x32."""
    dataset = nordland(
        root=str(SHARED / "data" / "nordland_64x32"),
        references=["winter"],
        stride=1,
        places=2761,
        query_places=2761,
        first_query_place=0,
        frame_multiple=10,
    )
    scores = SAD().fit(dataset.references, dataset.places).query(dataset.queries)
    return np.count_nonzero(scores > np.diagonal(scores)[:, None], axis=1)


@needs_corridor
def test_raw_sad_on_corridor_finds_47_of_111():
    # Regression anchor of the spec (metrics.md): 28x28 INTER_AREA grey.
    assert right(scored(SAD(preprocessing="grey"))) == 47


@needs_corridor
def test_sad_on_nordland_64x32_reaches_the_recall_and_the_intervals_of_independent_code(ranks):
    # Source of the rates: table "Orientation on real frames" of the VPRTempo rules document.
    rates = [float(np.mean(ranks < n)) for n in (1, 5, 10, 25)]
    assert rates == pytest.approx([0.2503, 0.4006, 0.4636, 0.5531], abs=0.003)
    bounds = [block_bootstrap(ranks == 0, block) for block in (1, 10, 50, 100)]
    half_widths = [(found.high - found.low) / 2 for found in bounds]
    assert half_widths == pytest.approx([0.016, 0.028, 0.046, 0.061], abs=0.0015)


@needs_corridor
def test_frames_of_nordland_64x32_are_alike_over_many_more_than_ten_and_the_interval_knows(ranks):
    found = share_interval(ranks == 0)
    assert found.kind == "blocks"
    assert 50 < found.block <= 158  # 3 sqrt(2761)
    assert found.high - found.low > 4 * 0.016  # at least twice as wide as without blocks
