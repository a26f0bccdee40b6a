"""The choice of VPRSNN's hyperactive neurons: by held-out places alone, from reactions that are counted by hand."""

from dataclasses import replace

import numpy as np
import pytest
from little_vprsnn import images, layers, lit, made

from vprbench.api.dataset import HeldOut
from vprbench.methods.vprsnn import query, training
from vprbench.methods.vprsnn.method import VPRSNN
from vprbench.methods.vprsnn.model import Model
from vprbench.methods.vprsnn.network import Network, ReadyNetwork
from vprbench.methods.vprsnn.parallel import Stage

N = 4
# Neuron 0 hears three inputs, neuron 1 one of them, neuron 2 another, neuron 3 none.
MADE = made([[0, 1, 2], [1], [3], []], [0, 1, 2, 2], N)
SIGHTS = lit(N, [0], [1], [2], [3], [], [0])


def by_hand(threshold=0, **arguments):
    """Return a method with the network made by hand, which has counted reactions to `SIGHTS`."""
    state = {**MADE, "reactions": np.array([[4, 1, 1, 0]]), "threshold": np.array(threshold)}
    return VPRSNN(height=1, width=N, n_excitatory=4, **arguments).restore(state)


def counted(state, sights, carried):
    """Return for how many sights each neuron fires."""
    model = Model(height=1, width=N, n_excitatory=4, carried_potentials=carried)
    return query.count_reactions(ReadyNetwork.of(model, Network.from_state(state, N, 4)), sights, Stage()).tolist()


def test_a_reaction_is_an_image_for_which_a_neuron_fires_however_often_and_in_whichever_company(monkeypatch):
    assert layers(by_hand(), SIGHTS)["excitatory"].max() > 1
    # Weak synapses: whether a neuron fires hangs on what the images before have left where that is carried.
    weak = {**MADE, "weights": 0.05 * MADE["weights"]}
    sights = np.random.default_rng(0).integers(0, 256, (60, N)).astype(np.uint8)
    carried = counted(weak, sights, True)
    assert carried != counted(weak, sights, False)
    for together in (1, 4, 256):
        monkeypatch.setattr(query, "_TOGETHER", together)
        assert counted(MADE, SIGHTS, False) == [[4, 1, 1, 0]]
        assert counted(weak, sights, True) == carried


@pytest.mark.parametrize(("threshold", "fires_for"), [(0, [0, 1]), (1, []), (4, [1]), (5, [0, 1])])
@pytest.mark.parametrize("assignment", ["standard", "weighted"])
def test_a_neuron_with_as_many_reactions_as_the_threshold_is_not_heard(threshold, fires_for, assignment):
    scores = by_hand(threshold, assignment=assignment).match(lit(N, [1]))  # neurons 0 and 1 fire, for places 0 and 1
    assert np.flatnonzero(scores[0] > 0).tolist() == fires_for
    assert np.isneginf(scores).all() == (not fires_for)


PIXELS = 8
BACKGROUND = range(2, PIXELS)  # pixels that are white in every image
# Neuron 0 hears pixel 0 and has learnt place 0, neuron 1 pixel 1 and place 1. Neuron 2 hears the background and has
# learnt place 0; four that hear nothing have learnt place 1. So place 0 scores the mean of two neurons, of which one
# always fires, and place 1 the fifth part of one neuron: a query of place 1 is taken for place 0 unless neuron 2 is
# silenced.
ASIDE = made([[0], [1], [*BACKGROUND], [], [], [], []], [0, 1, 0, 1, 1, 1, 1], PIXELS)
CANDIDATES = [0, 1, 3, 5, 6]


class Raw(VPRSNN):
    """VPRSNN that sees pixels as they are."""

    def encode(self, images):
        return np.stack([image[..., 0].ravel() for image in images])


def sights(*pixels):
    """Return one image a sequence of pixels, which are white in it beside the background."""
    levels = lit(PIXELS, *([*white, *BACKGROUND] for white in pixels))
    return images([np.repeat(row.reshape(1, PIXELS, 1), 3, axis=2) for row in levels])


def held_out(in_map=False):
    """Return two held-out places; of the first there are two images, in both traverses."""
    return HeldOut(sights([0], [1], [0]), np.array([0, 1, 0]), sights([0], [1]), np.array([0, 1]), in_map)


@pytest.fixture
def calibrated(monkeypatch):
    """Return a function that calibrates a map of three places by the network `ASIDE`."""
    monkeypatch.setattr(training.Training, "learn", lambda *_, **__: Network.from_state(ASIDE, PIXELS, 7))

    def calibrate(held_out, **arguments):
        given = {"height": 1, "width": PIXELS, "n_excitatory": 7, "hyperactive_candidates": CANDIDATES, **arguments}
        return Raw(**given).fit(sights([], [], []), np.arange(3)).calibrate(held_out)

    return calibrate


def chosen(calibrated):
    return int(calibrated.state()["threshold"])


# In a map of three other places neuron 2 has 3 + 2 reactions, neurons 0 and 1 one each: for 3 and 5 only neuron 2 is
# silent, and both queries are right; for 1 all are silent, for 0 and 6 none is, and one query is right.


@pytest.mark.parametrize(
    ("candidates", "right", "best"),
    [
        pytest.param(CANDIDATES, [0, 1], 3, id="the best recall"),
        pytest.param([6, 5, 3], [0, 1], 5, id="of equals the first"),
        pytest.param([1, 0, 6], [0, 1], 0, id="silence is wrong"),
        # Silencing neuron 2 makes place 1 the answer to the second query
        *((CANDIDATES, right, best) for right, best in (([1, 0], 0), ([0, 0], 0), ([1, 1], 3))),
    ],
)
def test_the_first_threshold_with_the_best_recall_of_held_out_queries_is_chosen(calibrated, candidates, right, best):
    found = calibrated(replace(held_out(), right=np.array(right)), hyperactive_candidates=candidates)
    assert chosen(found) == best
    assert ("reactions" in found.state()) == (best > 0)


@pytest.mark.parametrize(("in_map", "hyperactive"), [(False, 5), (True, 3)])
def test_reactions_are_counted_over_all_places_once_whether_or_not_the_map_has_the_held_out_ones(
    calibrated, in_map, hyperactive
):
    # The second image of held-out place 0 is of another traverse.
    found = calibrated(held_out(in_map), hyperactive_candidates=[0, hyperactive])
    assert chosen(found) == hyperactive
    alone = [0, 0] if in_map else [1, 1]
    assert found.state()["reactions"].tolist() == [[*alone, hyperactive, 0, 0, 0, 0]]
    assert chosen(calibrated(held_out(in_map), hyperactive_candidates=[0, hyperactive + 1])) == 0
