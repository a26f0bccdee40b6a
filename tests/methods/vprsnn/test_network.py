"""VPRSNN's network as stored arrays: what comes back, and what is refused."""

import numpy as np
import pytest
from little_vprsnn import SMALL, fitted, same

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


def little():
    """Return the arrays of two modules of three and two places, with 4 pixels and 3 neurons."""
    draw = np.random.default_rng(0)
    sums = draw.integers(0, 50, (2, 3, 3)).astype(np.float32)
    sums[1, :, 2] = 0
    return {
        **{"weights": draw.random((2, 4, 3)), "theta": draw.uniform(20, 30, (2, 3)), "sums": sums},
        **{"shown": np.array([[5, 5, 5], [5, 5, 0]]), "places": np.array([[0, 3, 1], [4, 2, -1]])},
        **{"threshold": np.array(7), "reactions": draw.integers(0, 9, (2, 3))},
    }


def refusal(state, **changes):
    """Return the line that refuses the arrays, and see that the method, which had a network, answers nothing."""
    asked = VPRSNN(height=2, width=2, n_excitatory=3).restore(little())
    for name, value in changes.items():
        setattr(asked, name, value)
    with pytest.raises(BadInput) as error:
        asked.restore(state)
    with pytest.raises(NotFittedError):
        asked.state()
    assert "\n" not in str(error.value)
    return str(error.value)


@pytest.mark.parametrize("name", little())
def test_an_array_that_is_missing_or_of_another_shape_is_refused(name):
    own = little()[name]
    wider = np.concatenate([np.atleast_2d(own), np.atleast_2d(own)[..., :1]], axis=-1)
    fewer = (own.reshape(-1)[0], own[:1]) if own.ndim else (np.repeat(own, 2),)
    for spoilt in (own[None], own.reshape(-1)[:0], wider, *fewer):
        refusal({**little(), name: np.asarray(spoilt)})
    assert name in refusal({key: array for key, array in little().items() if key != name})


def spoilt(name, at, value):
    state = little()
    state[name][at] = value
    return state


@pytest.mark.parametrize(
    ("state", "culprit"),
    [
        *((spoilt(name, (0, 1), value), name) for name in ("weights", "theta", "sums") for value in (np.nan, np.inf)),
        (spoilt("places", (1, 1), 3), "places"),  # one twice
        (spoilt("places", (1, 0), 5), "places"),  # one left out
        ({**little(), "places": np.array([[1, 3, 4], [5, 2, -1]])}, "places"),  # not from 0
        ({**little(), "places": np.full((2, 3), -1)}, "places"),  # none
        (spoilt("sums", (1, 0, 2), 3), "spikes"),  # for a place that is not there
        (spoilt("sums", (0, 0, 0), -3), "spikes"),
        ({**little(), "threshold": np.array(-1)}, "threshold"),
        ({**little(), "delays": np.zeros((2, 4, 3))}, "delays"),
    ],
)
def test_values_that_no_network_has_are_refused(state, culprit):
    assert culprit in refusal(state)
