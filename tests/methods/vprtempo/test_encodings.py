"""What VPRTempo reads of a frame: patches, oriented edges or Gabor filters; and grey levels as input spikes."""

from __future__ import annotations

from typing import Any, get_args

import numpy as np
import pytest
from tempo_networks import QUERIES, REFERENCES, SMALL, WORLD
from tempo_networks import fitted as fitted_by

from vprbench.api.gabor import GaborBank
from vprbench.api.oriented import OrientedEdges
from vprbench.errors import BadInput
from vprbench.methods.vprtempo.arguments import Encoding
from vprbench.methods.vprtempo.encoding import spikes_of
from vprbench.methods.vprtempo.ensemble import VPRTempoEnsemble
from vprbench.methods.vprtempo.int8 import VPRTempoInt8
from vprbench.methods.vprtempo.method import VPRTempo
from vprbench.methods.vprtempo.rules import QueryRule
from vprbench.plugins.conformance import check
from vprbench.plugins.registry import make_method
from vprbench.run import compose

INPUTS: dict[str, Any] = {
    "oriented": {"encoding": "oriented", "height": 16, "width": 20, "rows": 4, "columns": 5, "max_module": 8},
    # At the paper's fan-in so many inputs that are active at once leave nearly all features silent.
    "gabor": {
        **{"encoding": "gabor", "height": 12, "width": 12, "features_per_pixel": 0.5, "max_module": 8},
        **{"p_excitatory": 0.02, "p_inhibitory": 0.02},
    },
}
# Float32 near 1 has steps of 6e-8, and its rounding acts twice or three times.
ROUNDING = 2.5e-7
ENCODINGS = pytest.mark.parametrize("encoding", INPUTS)


def fitted(encoding: str, kind: type[VPRTempo] = VPRTempo, **arguments: Any) -> VPRTempo:
    return fitted_by(kind, **{**INPUTS[encoding], **arguments})


def test_input_spikes_are_the_codes_of_the_encoder() -> None:
    oriented = VPRTempo(encoding="oriented", height=30, width=50, rows=5, columns=7, orientations=6)
    assert np.array_equal(oriented.encode(QUERIES), OrientedEdges(30, 50, 5, 7, 6)(QUERIES))
    gabor = VPRTempo(encoding="gabor", height=20, width=24, patch=9)
    assert np.array_equal(gabor.encode(QUERIES), GaborBank(20, 24, 9)(QUERIES))


@pytest.mark.parametrize("encoding", get_args(Encoding))
def test_the_encoder_runs_by_the_engine_that_trains(encoding: Encoding) -> None:
    for engine, expected in (("fused", "fused"), ("readable", "readable"), (None, "fused")):
        encoder: Any = VPRTempo(encoding=encoding, engine=engine).encoder()
        assert getattr(encoder, "levels", encoder).engine == expected


@pytest.mark.parametrize(
    ("encoding", "kind"), [("oriented", VPRTempoInt8), ("gabor", VPRTempo), ("gabor", VPRTempoEnsemble)]
)
def test_the_contract_is_kept_with_any_input(encoding: str, kind: type[VPRTempo]) -> None:
    config = {"_target_": f"{kind.__module__}.{kind.__name__}", **INPUTS[encoding]}
    assert [str(result) for result in check(config) if result.state != "kept"] == []


@ENCODINGS
@pytest.mark.parametrize("query_rule", get_args(QueryRule))
def test_both_engines_learn_the_same_and_find_the_places(encoding: str, query_rule: QueryRule) -> None:
    fused, readable = (fitted(encoding, query_rule=query_rule, engine=engine) for engine in ("fused", "readable"))
    scores = fused.query(QUERIES)
    assert scores == pytest.approx(readable.query(QUERIES), abs=2e-3 * float(np.abs(scores).max()))
    assert np.mean(fused.query(REFERENCES).argmax(1) == WORLD.places) > 0.5


@ENCODINGS
def test_spikes_begin_with_the_input_and_another_input_is_refused_on_restoring(encoding: str) -> None:
    method = fitted(encoding)
    layers, n_inputs = method.spikes(method.encode(QUERIES)), method.encoder().n_inputs
    assert [layer.name for layer in layers] == ["input", "feature", "output"]
    assert np.array_equal(layers[0].values, method.encode(QUERIES))
    assert layers[0].values.shape[1] == n_inputs
    restored = VPRTempo(**INPUTS[encoding]).restore(method.state())
    assert np.array_equal(restored.query(QUERIES), method.query(QUERIES))
    with pytest.raises(BadInput, match=rf"reads {n_inputs} inputs, not the 144 of method\.encoding=patches"):
        VPRTempo(**SMALL).restore(method.state())


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
        VPRTempo(**{**INPUTS["oriented"], **arguments}).fit(REFERENCES, WORLD.places)


@pytest.mark.parametrize(("name", "n_inputs"), [("vprtempo_oriented", 2048), ("vprtempo_oriented_ensemble", 3072)])
def test_the_methods_of_oriented_edges_read_as_many_as_they_say(name: str, n_inputs: int) -> None:
    method = make_method(compose.composed([f"method={name}"])["method"])
    assert method.encode(QUERIES).shape == (len(QUERIES), n_inputs)


def test_a_spike_is_the_level_over_255_or_the_nearest_255th_of_the_maximum_of_its_image() -> None:
    every = np.arange(256)[None].astype(np.uint8)
    for fake_quantised in (False, True):  # under a maximum of 255 the step of 8 bits changes nothing
        assert spikes_of(every, fake_quantised) == pytest.approx(every / 255, abs=ROUNDING)
    # Maximum 51 of 255 = 0.2, so a step of the grid is 0.2 / 255. Level 10 is 50 steps exactly, as a level is 5.
    # Maximum 201: level 100 is 100 * 255 / 201 = 126.87 steps, the 127th; level 50 is 63.43, the 63rd.
    found = spikes_of(np.array([[51, 10, 0], [201, 100, 50], [0, 0, 0]], np.uint8), True)
    expected = [[0.2, 50 * 0.2 / 255, 0], [201 / 255, 127 * 201 / 255**2, 63 * 201 / 255**2], [0, 0, 0]]
    assert found == pytest.approx(np.array(expected), abs=ROUNDING)
    levels = np.arange(128)  # under an odd maximum no level lies halfway between two points
    found = spikes_of(levels[None].astype(np.uint8), True)[0]
    assert found == pytest.approx(np.round(levels * 255 / 127) * 127 / 255 / 255, abs=ROUNDING)
    assert (found.dtype, spikes_of(every[:0], True).shape) == (np.float32, (0, 256))
