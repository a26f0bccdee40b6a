"""VPRSNN's network as stored arrays: a stored one comes back, and arrays that are no network are refused."""

import numpy as np
import pytest
from little_vprsnn import SMALL, fitted
from states import same

from vprbench.errors import BadInput, NotFittedError
from vprbench.methods.vprsnn.method import VPRSNN


def test_a_restored_network_is_the_stored_one_and_answers_alike():
    trained = fitted(7, hyperactive_threshold=3)
    stored = {name: array.copy() for name, array in trained.state().items()}
    assert {name: array.shape for name, array in stored.items()} == {
        **{"weights": (2, 144, 24), "theta": (2, 24), "sums": (2, 24, 5), "shown": (2, 5), "places": (2, 5)},
        **{"threshold": (), "reactions": (2, 24)},
    }
    assert stored["places"].tolist() == [[0, 1, 2, 3, 4], [5, 6, -1, -1, -1]]
    assert stored["shown"][1].tolist() == [12, 12, 0, 0, 0]  # 2 images in each of 6 epochs
    assert not stored["sums"][1, :, 2:].any()
    restored = VPRSNN(**SMALL).restore(stored)
    assert same(restored.state(), stored)
    for given, kept in ((None, 3), (0, 0), (5, 5)):
        assert VPRSNN(**SMALL, hyperactive_threshold=given).restore(stored).state()["threshold"] == kept


def little(**changes):
    """Return the arrays of two modules of three and two places, with 4 pixels and 3 neurons."""
    draw = np.random.default_rng(0)
    return {
        **{"weights": draw.random((2, 4, 3)), "theta": draw.uniform(20, 30, (2, 3)), "sums": np.ones((2, 3, 3))},
        **{"shown": np.array([[5, 5, 5], [5, 5, 0]]), "places": np.array([[0, 3, 1], [4, 2, -1]])},
        **{"threshold": np.array(7), "reactions": draw.integers(0, 9, (2, 3))},
        **changes,
    }


@pytest.mark.parametrize(
    ("state", "culprit"),
    [
        *(({name: array for name, array in little().items() if name != missing}, missing) for missing in little()),
        *((little(**{name: array[None]}), name) for name, array in little().items()),
        *((little(**{name: np.full_like(little()[name], np.nan)}), name) for name in ("weights", "theta", "sums")),
        # one twice, not from 0, none
        *((little(places=np.array(places)), "places") for places in ([[0, 3, 1], [4, 3, -1]], [[1, 3, 4], [5, 2, -1]])),
        (little(places=np.full((2, 3), -1)), "places"),
        (little(delays=np.zeros((2, 4, 3))), "delays"),
        (little(threshold=np.array(7), reactions=np.zeros((2, 4))), "reactions"),
    ],
)
def test_arrays_that_are_no_network_are_refused_by_name_and_leave_none(state, culprit):
    asked = VPRSNN(height=2, width=2, n_excitatory=3, hyperactive_threshold=4).restore(little())
    with pytest.raises(BadInput, match=culprit):
        asked.restore(state)
    with pytest.raises(NotFittedError):
        asked.state()
