"""What VPRTempo reads of a frame: patches, oriented edges or Gabor filters, under every engine and way of asking."""

from __future__ import annotations

from functools import cache
from typing import Any, get_args

import numpy as np
import numpy.typing as npt
import pytest

from vprbench.api.gabor import GaborBank
from vprbench.api.images import Images
from vprbench.api.oriented import OrientedEdges
from vprbench.errors import BadInput
from vprbench.methods.vprtempo.arguments import Encoding
from vprbench.methods.vprtempo.ensemble import VPRTempoEnsemble
from vprbench.methods.vprtempo.int8 import VPRTempoInt8
from vprbench.methods.vprtempo.method import VPRTempo
from vprbench.methods.vprtempo.rules import QueryRule
from vprbench.plugins.conformance import check
from vprbench.plugins.registry import make_method
from vprbench.plugins.rules import N_PLACES, Journey
from vprbench.run import compose

WORLD = Journey.draw(0)
REFERENCES, QUERIES = Images.from_arrays(WORLD.references), Images.from_arrays(WORLD.queries)
SMALL: dict[str, Any] = {
    "oriented": {"encoding": "oriented", "height": 16, "width": 20, "rows": 4, "columns": 5, "max_module": 8},
    # At the paper's fan-in so many inputs that are active at once leave nearly all features silent.
    "gabor": {
        **{"encoding": "gabor", "height": 12, "width": 12, "features_per_pixel": 0.5, "max_module": 8},
        **{"p_excitatory": 0.02, "p_inhibitory": 0.02},
    },
}
ENCODINGS = pytest.mark.parametrize("encoding", SMALL)


@cache
def fitted(encoding: str, kind: type[VPRTempo] = VPRTempo, **arguments: Any) -> VPRTempo:
    return kind(**{**SMALL[encoding], **arguments}).fit(REFERENCES, WORLD.places)


def best(method: VPRTempo, images: Images = QUERIES) -> npt.NDArray[np.int64]:
    return method.query(images).argmax(1)


def test_input_spikes_are_the_codes_of_the_encoder() -> None:
    oriented = VPRTempo(encoding="oriented", height=30, width=50, rows=5, columns=7, orientations=6)
    assert np.array_equal(oriented.encode(QUERIES), OrientedEdges(30, 50, 5, 7, 6)(QUERIES))
    gabor = VPRTempo(encoding="gabor", height=20, width=24, patch=9)
    assert np.array_equal(gabor.encode(QUERIES), GaborBank(20, 24, 9)(QUERIES))


@pytest.mark.parametrize("encoding", get_args(Encoding))
@pytest.mark.parametrize("engine", ["fused", "readable"])
def test_the_encoder_runs_by_the_engine_that_trains(encoding: Encoding, engine: Any) -> None:
    encoder: Any = VPRTempo(encoding=encoding, engine=engine).encoder()
    assert getattr(encoder, "levels", encoder).engine == engine


@ENCODINGS
@pytest.mark.parametrize("kind", [VPRTempo, VPRTempoInt8, VPRTempoEnsemble])
def test_the_contract_is_kept_with_any_input(encoding: str, kind: type[VPRTempo]) -> None:
    config = {"_target_": f"{kind.__module__}.{kind.__name__}", **SMALL[encoding]}
    broken = [str(result) for result in check(config) if result.state != "kept"]
    assert broken == []


@ENCODINGS
@pytest.mark.parametrize("query_rule", get_args(QueryRule))
def test_both_engines_learn_the_same_and_find_the_places(encoding: str, query_rule: QueryRule) -> None:
    fused, readable = (fitted(encoding, query_rule=query_rule, engine=engine) for engine in ("fused", "readable"))
    scores = fused.query(QUERIES)
    assert scores == pytest.approx(readable.query(QUERIES), abs=2e-3 * float(np.abs(scores).max()))
    assert np.mean(best(fused, REFERENCES) == WORLD.places) > 0.5


@ENCODINGS
def test_a_member_of_an_ensemble_is_the_network_of_its_seed(encoding: str) -> None:
    state = fitted(encoding, VPRTempoEnsemble, members=2, seed=3).state()
    for number in range(2):
        alone = fitted(encoding, seed=3 + number).state()
        assert all(np.array_equal(state[f"member_{number}.{name}"], array) for name, array in alone.items())


@ENCODINGS
def test_8_bits_find_nearly_the_same_places(encoding: str) -> None:
    floating, rounded = (fitted(encoding, kind) for kind in (VPRTempo, VPRTempoInt8))
    assert np.mean(best(floating, REFERENCES) == best(rounded, REFERENCES)) >= 0.9


@ENCODINGS
def test_the_spikes_of_a_network_begin_with_its_input(encoding: str) -> None:
    method = fitted(encoding)
    layers = method.spikes(method.encode(QUERIES))
    assert [layer.name for layer in layers] == ["input", "feature", "output"]
    assert np.array_equal(layers[0].values, method.encode(QUERIES))
    assert layers[0].values.shape[1] == method.encoder().n_inputs


@ENCODINGS
def test_a_restored_network_answers_as_before_and_one_of_another_input_is_refused(encoding: str) -> None:
    trained = fitted(encoding)
    restored = VPRTempo(**SMALL[encoding]).restore(trained.state())
    assert np.array_equal(restored.query(QUERIES), trained.query(QUERIES))
    n_inputs = trained.encoder().n_inputs
    with pytest.raises(BadInput, match=rf"reads {n_inputs} inputs, not the 144 of method\.encoding=patches") as error:
        VPRTempo(max_module=8, height=12, width=12).restore(trained.state())
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("other", [{"rows": 3}, {"columns": 4}, {"orientations": 6}, {"height": 12}], ids=str)
def test_every_argument_of_oriented_edges_changes_the_scores(other: dict[str, Any]) -> None:
    assert not np.allclose(fitted("oriented").query(QUERIES), fitted("oriented", **other).query(QUERIES), rtol=1e-3)


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        ({"rows": 0}, r"method\.rows=0"),
        ({"orientations": 1}, r"method\.orientations=1"),
        ({"encoding": "gabor", "height": 4}, r"method\.height=4"),
    ],
    ids=str,
)
def test_sizes_without_an_input_are_refused_by_name(arguments: dict[str, Any], wanted: str) -> None:
    with pytest.raises(BadInput, match=wanted):
        VPRTempo(**{**SMALL["oriented"], **arguments}).fit(REFERENCES, WORLD.places)


def test_frames_of_any_sizes_are_read_together() -> None:
    frames = [*WORLD.queries, WORLD.queries[0][:1], WORLD.queries[0][::2, ::3], np.zeros((700, 1, 3), np.uint8)]
    found = fitted("oriented").query(Images.from_arrays(frames))
    assert found.shape == (len(frames), N_PLACES)
    assert np.isfinite(found).all()


def active(monkeypatch: pytest.MonkeyPatch, **arguments: Any) -> float:
    """The share of feature neurons that spike for any reference; nobody asks whether the result can be trusted."""
    monkeypatch.setattr("vprbench.methods.vprtempo.method.check_winners", lambda *_: None)
    method = VPRTempo(**{**SMALL["gabor"], "max_module": N_PLACES, **arguments}).fit(REFERENCES, WORLD.places)
    features = method.spikes(method.encode(REFERENCES))[1]
    return float((features.values > 0).any(0).mean())


def test_without_adapted_thresholds_most_features_of_gabor_maps_are_dead(monkeypatch: pytest.MonkeyPatch) -> None:
    high = {"threshold_max": 2.0}
    assert active(monkeypatch, **high, itp_rate=0.0) < 0.2
    assert active(monkeypatch, **high, itp_rate=0.15) > 0.8


@pytest.mark.parametrize(("name", "n_inputs"), [("vprtempo_oriented", 2048), ("vprtempo_oriented_ensemble", 3072)])
def test_the_methods_of_oriented_edges_read_as_many_as_they_say(name: str, n_inputs: int) -> None:
    method = make_method(compose.composed([f"method={name}"])["method"])
    assert method.encode(QUERIES).shape == (len(QUERIES), n_inputs)


@pytest.mark.parametrize("probability", [0.02, 0.5], ids=["few synapses", "many"])
def test_a_query_alone_scores_as_among_others_however_few_synapses_there_are(probability: float) -> None:
    method = fitted("oriented", p_excitatory=probability, p_inhibitory=probability)
    codes = method.encode(QUERIES)
    alone = np.concatenate([method.match(code[None]) for code in codes])
    assert alone == pytest.approx(method.match(codes), abs=1e-6)
