"""The choice of VPRSNN's hyperactive neurons: by held-out places alone, from reactions that are counted by hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NoReturn

import numpy as np
import numpy.typing as npt
import pytest
from little_vprsnn import SMALL, WORLD, fitted, images, layers, lit, made, references, same, tiny_recipe

from vprbench.api.arrays import Places
from vprbench.api.dataset import HeldOut
from vprbench.api.images import Images
from vprbench.errors import NotFittedError
from vprbench.methods.vprsnn import asking, method, training
from vprbench.methods.vprsnn.asking import Asked, reactions
from vprbench.methods.vprsnn.ensemble import VPRSNNEnsemble
from vprbench.methods.vprsnn.method import VPRSNN
from vprbench.methods.vprsnn.network import Network

# --- reactions --------------------------------------------------------------------------------------------------

N = 4
# Neuron 0 hears three inputs, neuron 1 one of them, neuron 2 another, neuron 3 none.
MADE = made([[0, 1, 2], [1], [3], []], [0, 1, 2, 2], N)
SIGHTS = lit(N, [0], [1], [2], [3], [], [0])


def by_hand(threshold: int = 0, **arguments: Any) -> VPRSNN:
    """Return a method with the network made by hand, which has counted reactions to `SIGHTS`."""
    state = {**MADE, "reactions": np.array([[4, 1, 1, 0]]), "threshold": np.array(threshold)}
    return VPRSNN(height=1, width=N, n_excitatory=4, **arguments).restore(state)


def asked(state: dict[str, npt.NDArray[Any]]) -> Asked:
    return Asked.of(tiny_recipe(n_inputs=N, n_neurons=4), Network.from_state(state, N, 4), True, 0)


def test_a_reaction_is_an_image_for_which_a_neuron_fires_however_often() -> None:
    codes = SIGHTS
    assert layers(by_hand(), codes)["excitatory"].max() > 1
    assert reactions(asked(MADE), codes, False, None, "counting").tolist() == [[4, 1, 1, 0]]


@pytest.mark.parametrize("together", [1, 4])
def test_reactions_are_the_same_however_many_images_are_asked_together(
    monkeypatch: pytest.MonkeyPatch, together: int
) -> None:
    monkeypatch.setattr(asking, "_TOGETHER", together)
    assert reactions(asked(MADE), SIGHTS, False, None, "counting").tolist() == [[4, 1, 1, 0]]


def test_carried_potentials_are_carried_through_all_the_images_that_are_counted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Weak synapses: whether a neuron fires hangs on what the images before have left.
    weak = {**MADE, "weights": 0.05 * MADE["weights"]}
    sights = np.random.default_rng(0).integers(0, 256, (60, N)).astype(np.uint8)
    expected = reactions(asked(weak), sights, True, None, "counting").tolist()
    assert expected != reactions(asked(weak), sights, False, None, "counting").tolist()
    monkeypatch.setattr(asking, "_TOGETHER", 2)
    assert reactions(asked(weak), sights, True, None, "counting").tolist() == expected


@pytest.mark.parametrize(("threshold", "fires_for"), [(0, [0, 1]), (1, []), (2, [1]), (4, [1]), (5, [0, 1])])
def test_a_neuron_with_as_many_reactions_as_the_threshold_is_not_heard(threshold: int, fires_for: list[int]) -> None:
    scores = by_hand(threshold).match(lit(N, [1]))  # neurons 0 and 1 fire, for places 0 and 1
    assert np.flatnonzero(scores[0] > 0).tolist() == fires_for
    assert np.isneginf(scores).all() == (not fires_for)


def test_a_silenced_neuron_still_fires_and_inhibits() -> None:
    heard, silenced = by_hand(0), by_hand(2)
    codes = lit(N, [0, 1, 2, 3])
    assert layers(heard, codes)["excitatory"][0, 0] > 0
    assert np.array_equal(layers(heard, codes)["excitatory"], layers(silenced, codes)["excitatory"])
    assert np.array_equal(heard.match(codes)[:, 1:], silenced.match(codes)[:, 1:])


def test_a_silenced_neuron_is_not_heard_in_the_weighted_assignment_either() -> None:
    assert by_hand(2, assignment="weighted").match(lit(N, [1]))[0].tolist()[0] == 0
    assert by_hand(0, assignment="weighted").match(lit(N, [1]))[0].tolist()[0] > 0


# --- the choice, all of it by hand ------------------------------------------------------------------------------

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

    def encode(self, images: Images) -> npt.NDArray[np.uint8]:
        return np.stack([image[..., 0].ravel() for image in images])


def sights(*pixels: Sequence[int]) -> Images:
    """Return one image a sequence of pixels, which are white in it beside the background."""
    levels = lit(PIXELS, *([*white, *BACKGROUND] for white in pixels))
    return images([np.repeat(row.reshape(1, PIXELS, 1), 3, axis=2) for row in levels])


def held_out(in_map: bool = False) -> HeldOut:
    """Return two held-out places; of the first there are two images, in both traverses."""
    return HeldOut(sights([0], [1], [0]), np.array([0, 1, 0]), sights([0], [1]), np.array([0, 1]), in_map)


@pytest.fixture
def calibrated(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Raw]:
    """What calibrates a map of three places: its network, too, is as good as `ASIDE`, or as is said."""

    def calibrate(held_out: HeldOut, of_map: dict[str, npt.NDArray[Any]] = ASIDE, **arguments: Any) -> Raw:
        def train_all(*called: Any, **_: Any) -> Network:
            is_aside = called[3].startswith("calibration")
            return Network.from_state(ASIDE if is_aside else of_map, PIXELS, 7)

        monkeypatch.setattr(method, "train_all", train_all)
        given = {"height": 1, "width": PIXELS, "n_excitatory": 7, "hyperactive_candidates": CANDIDATES, **arguments}
        return Raw(**given).fit(sights([], [], []), np.arange(3)).calibrate(held_out)

    return calibrate


def chosen(calibrated: VPRSNN) -> int:
    return int(calibrated.state()["threshold"])


# In a map of three other places neuron 2 has 3 + 2 reactions, neurons 0 and 1 one each: for 3 and 5 only neuron 2 is
# silent, and both queries are right; for 1 all are silent, for 0 and 6 none is, and one query is right.


def test_the_first_threshold_with_the_best_recall_of_held_out_queries_is_chosen(
    calibrated: Callable[..., Raw],
) -> None:
    assert chosen(calibrated(held_out())) == 3


def test_what_was_chosen_and_whom_it_silences_is_noted(calibrated: Callable[..., Raw]) -> None:
    # of the map's seven neurons those fire for 3 images or more that hear the background alone: one
    (note,) = calibrated(held_out()).notes()
    assert note == "neurons that fired for 3 references or more (chosen by held-out places) are silenced: 1 of 7"
    (note,) = calibrated(held_out(), hyperactive_candidates=[0]).notes()
    assert note.startswith("no neuron is silenced")
    given = calibrated(held_out())
    given.hyperactive_threshold = 3
    assert given.notes() == ["neurons that fired for 3 references or more (given) are silenced: 1 of 7"]


def test_of_thresholds_that_recall_as_much_the_first_candidate_is_chosen(calibrated: Callable[..., Raw]) -> None:
    assert chosen(calibrated(held_out(), hyperactive_candidates=[6, 5, 3])) == 5


def test_no_neuron_is_silenced_where_that_never_helps(calibrated: Callable[..., Raw]) -> None:
    found = calibrated(held_out(), hyperactive_candidates=[0, 1, 6])
    assert chosen(found) == 0
    assert "reactions" not in found.state()


@pytest.mark.parametrize(("in_map", "hyperactive"), [(False, 5), (True, 3)])
def test_reactions_are_counted_over_all_places_once_whether_or_not_the_map_has_the_held_out_ones(
    calibrated: Callable[..., Raw], in_map: bool, hyperactive: int
) -> None:
    # The second image of held-out place 0 is of another traverse.
    found = calibrated(held_out(in_map), hyperactive_candidates=[0, hyperactive])
    assert chosen(found) == hyperactive
    alone = [0, 0] if in_map else [1, 1]
    assert found.state()["reactions"].tolist() == [[*alone, hyperactive, 0, 0, 0, 0]]
    assert chosen(calibrated(held_out(in_map), hyperactive_candidates=[0, hyperactive + 1])) == 0


def test_the_network_of_the_map_has_no_say_in_the_choice_but_counts_its_own_reactions(
    calibrated: Callable[..., Raw],
) -> None:
    # In the map's network the neuron that hears the background is number 4 and the only one for its place.
    of_map = made([[0], [1], [], [], [*BACKGROUND], [], []], [0, 1, 1, 1, 2, 1, 1], PIXELS)
    found = calibrated(held_out(), of_map)
    assert chosen(found) == 3
    assert found.state()["reactions"].tolist() == [[1, 1, 0, 0, 5, 0, 0]]
    assert np.isneginf(found.query(sights([]))).all()


@pytest.mark.parametrize("places", [[1, 0], [0, 0], [1, 1]])
def test_the_choice_follows_what_is_right_of_the_held_out_queries(
    calibrated: Callable[..., Raw], places: list[int]
) -> None:
    # Queries of places 0 and 1: silencing neuron 2 makes place 1 the answer to the second.
    given = replace(held_out(), right=np.array(places))
    assert chosen(calibrated(given)) == (3 if places[1] == 1 else 0)


# --- the choice in a trained network ----------------------------------------------------------------------------


def others(in_map: bool = False, n_places: int = 10) -> HeldOut:
    """Return places 10 to 19 of the made-up world; the maps of these tests have the first five."""
    shown, places = references(n_places, 10)
    return HeldOut(shown, places, images(WORLD.references[30 : 30 + n_places]), np.arange(n_places), in_map)


def certain(threshold: int = 5) -> VPRSNN:
    """Return a trained network of five places that has but one threshold to choose."""
    return fitted(hyperactive_candidates=[threshold])


def test_calibration_changes_nothing_but_the_threshold() -> None:
    before = certain()
    state, codes = dict(before.state()), before.encode(images(WORLD.queries))
    spikes = layers(before, codes)
    after = before.calibrate(others())
    assert after is before
    changed = {**state, "threshold": np.array(5), "reactions": after.state()["reactions"]}
    assert same(after.state(), changed)
    assert all(np.array_equal(counts, spikes[name]) for name, counts in layers(after, codes).items())


def test_reactions_of_the_map_are_to_its_first_traverse_and_to_the_held_out_places() -> None:
    found = certain().calibrate(others())
    fires = layers(found, found.encode(images(WORLD.references[:5] + WORLD.references[10:20])))["excitatory"] > 0
    assert len(set(fires.sum(axis=0).tolist())) > 3
    assert found.state()["reactions"].ravel().tolist() == fires.sum(axis=0).tolist()


def test_a_calibration_is_the_same_again_and_forgets_an_earlier_one() -> None:
    found = certain().calibrate(others(n_places=7)).calibrate(others())
    assert same(found.state(), certain().calibrate(others()).state())


def test_a_calibration_that_silences_nobody_forgets_that_an_earlier_one_did() -> None:
    found = certain().calibrate(others())
    assert chosen(found) == 5
    found.hyperactive_candidates = [0]
    assert chosen(found.calibrate(others())) == 0


def test_the_modules_of_held_out_places_draw_other_random_numbers_than_those_of_the_map(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seen: list[int] = []
    learn = training.train

    def watch(*called: Any) -> Any:
        seen.append(called[1].number)
        return learn(*called)

    monkeypatch.setattr(training, "train", watch)
    certain().calibrate(others())
    assert len(set(seen)) == len(seen) == 3


@pytest.mark.parametrize("threshold", [0, 4])
def test_a_threshold_that_is_given_stays(threshold: int, monkeypatch: pytest.MonkeyPatch) -> None:
    found = fitted(hyperactive_threshold=threshold)
    state = dict(found.state())
    assert chosen(found) == threshold

    def train(*_: Any) -> NoReturn:
        raise AssertionError("there is nothing to choose")

    monkeypatch.setattr(training, "train", train)
    assert same(found.calibrate(others()).state(), state)


def test_a_threshold_that_is_given_counts_reactions_to_the_first_traverse() -> None:
    found = fitted(hyperactive_threshold=4)
    fires = layers(found, found.encode(images(WORLD.references[:5])))["excitatory"] > 0
    assert len(set(fires.sum(axis=0).tolist())) > 1
    assert found.state()["reactions"].ravel().tolist() == fires.sum(axis=0).tolist()


def test_a_threshold_of_0_counts_nothing_and_silences_nobody() -> None:
    none = fitted(hyperactive_threshold=0)
    assert "reactions" not in none.state()
    codes = none.encode(images(WORLD.queries))
    assert np.array_equal(
        none.match(codes), fitted(hyperactive_threshold=6).match(codes)
    )  # 5 images: nobody reacts to 6
    assert not np.array_equal(none.match(codes), fitted(hyperactive_threshold=4).match(codes))


def test_without_held_out_places_nobody_is_silenced() -> None:
    assert chosen(fitted()) == 0
    assert same(fitted().state(), fitted(hyperactive_threshold=0).state())


def test_a_calibration_before_fit_is_refused() -> None:
    with pytest.raises(NotFittedError, match="fit"):
        VPRSNN(**SMALL).calibrate(others())


def test_each_member_of_an_ensemble_is_calibrated_as_it_would_be_alone() -> None:
    given: dict[str, Any] = {**SMALL, "hyperactive_candidates": [5, 10]}
    together = VPRSNNEnsemble(**given, seeds=[0, 10]).fit(*references(5)).calibrate(others()).state()
    for number, seed in enumerate((0, 10)):
        alone = VPRSNN(**given, seed=seed).fit(*references(5)).calibrate(others()).state()
        own = {
            name.partition(".")[2]: array for name, array in together.items() if name.startswith(f"member_{number}.")
        }
        assert same(own, alone)
        assert alone["threshold"] > 0


def test_places_are_held_out_as_arrays_that_cannot_be_written() -> None:
    shown, places = references(10, 10)
    frozen: Places = places.copy()
    frozen.flags.writeable = False
    right = np.arange(10)
    right.flags.writeable = False
    given = HeldOut(shown.unnamed(), frozen, images(WORLD.references[30:40]).unnamed(), right, in_map=False)
    assert same(certain().calibrate(given).state(), certain().calibrate(others()).state())
