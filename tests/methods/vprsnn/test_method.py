"""VPRSNN as a method: what it recognises, exactly and in its approximation, and what it does before it has learnt."""

from __future__ import annotations

from typing import Any, NoReturn

import numpy as np
import pytest
import yaml
from checkout import ROOT
from little_vprsnn import SMALL, WORLD, fitted, held_out, images, references, same

from vprbench.errors import BadInput, NotFittedError
from vprbench.methods.vprsnn import training
from vprbench.methods.vprsnn.method import VPRSNN
from vprbench.plugins.conformance import check
from vprbench.run.compose import composed_in_python
from vprbench.run.settings import checked_settings

CONFIGURATIONS = ROOT / "conf" / "method"
QUERIES = images(WORLD.queries)

# --- what it recognises -----------------------------------------------------------------------------------------


def test_five_places_learnt_at_full_resolution_are_recognised() -> None:
    shown, places = references(5)
    method = VPRSNN(places_per_module=5, n_excitatory=100).fit(shown, places)
    assert method.query(shown).argmax(1).tolist() == places.tolist()


def test_shuffled_modules_answer_for_their_own_places() -> None:
    method = fitted(10, module_order="shuffled", seed=3, calibration_places=2)
    assert not np.array_equal(method.state()["places"].ravel(), np.arange(10))
    assert np.mean(method.query(references(10)[0]).argmax(1) == np.tile(np.arange(10), 2)) > 0.7


def test_an_image_without_light_is_no_match() -> None:
    assert fitted().match(np.zeros((1, 144), np.uint8)).tolist() == [[-np.inf] * 5]


def test_with_carried_potentials_it_keeps_all_rules_of_the_contract_but_two() -> None:
    config = {**yaml.safe_load((CONFIGURATIONS / "vprsnn.yaml").read_text()), "seed": 0}
    results = list(check({**config, **SMALL, "carried_potentials": True}, set(SMALL)))
    assert [str(result) for result in results if result.state == "broken"] == []
    assert sum(result.state == "excepted" for result in results) == 2


def test_fast_leaves_out_the_delays_and_nothing_else() -> None:
    fast, codes = fitted(10, fast=True, epochs=12), fitted().encode(QUERIES)
    without = fitted(10, input_delay_max_ms=0.0, epochs=12)
    assert same(fast.state(), without.state())
    assert np.array_equal(fast.match(codes), without.match(codes))
    shown, places = references(10)
    assert np.mean(fast.query(shown).argmax(1) == places) > 0.7


# --- before a network is there ----------------------------------------------------------------------------------


def test_a_gpu_is_refused_to_a_method_without_an_argument_device() -> None:
    for name, fits in (("vprsnn", False), ("vprsnn_ensemble", False), ("vprtempo", True)):
        with pytest.raises(BadInput, match=r"device=cuda") as error:
            checked_settings(composed_in_python([f"method={name}"], {"device": "cuda:999"}))
        assert ("has no argument device" in str(error.value)) is not fits


@pytest.mark.parametrize("ask", ["query", "state", "spikes", "match", "calibrate"])
def test_nothing_is_answered_before_fit(ask: str) -> None:
    method = VPRSNN(**SMALL)
    codes = method.encode(QUERIES)
    given = {"query": (QUERIES,), "state": (), "spikes": (codes,), "match": (codes,), "calibrate": (held_out(),)}
    with pytest.raises(NotFittedError, match="fit"):
        getattr(method, ask)(*given[ask])


def test_a_training_that_is_interrupted_leaves_no_older_network(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: Any) -> NoReturn:
        raise KeyboardInterrupt

    method = fitted(epochs=1)
    monkeypatch.setattr(training, "train", interrupt)
    with pytest.raises(KeyboardInterrupt):
        method.fit(*references(10))
    with pytest.raises(NotFittedError):
        method.query(QUERIES)
