"""LENS: its neurons against a simulation written out, its training, and the layout its authors store."""

from collections import OrderedDict

import numpy as np
import pytest
import torch

from vprbench.api import BadInput
from vprbench.api.images import Images
from vprbench.methods.lens import Lens
from vprbench.plugins import networks

SIDE, PLACES = 4, 12
DRAW = np.random.default_rng(0)
FRAMES = Images.from_arrays(
    [np.repeat(frame, 3, 2) for frame in DRAW.integers(0, 256, (PLACES, SIDE, SIDE, 1), np.uint8)]
)
SMALL = {"height": SIDE, "width": SIDE, "steps": 200}


def published(n_features=9, n_places=PLACES, n_pixels=SIDE**2):
    """A state dictionary as LENS stores it; its weights are multiples of 1/16, so that every sum is exact."""
    generator = torch.Generator().manual_seed(3)
    layers = {"feature_layer": (n_features, n_pixels), "output_layer": (n_places, n_features)}
    state = OrderedDict()
    for layer, (post, pre) in layers.items():
        state[f"{layer}.thr"] = torch.rand(1, post, generator=generator)
        state[f"{layer}.w.weight"] = torch.randint(-10, 24, (post, pre), generator=generator) / 16
    return state


def layer(weights, spikes):
    """Integrate and fire step by step: as many spikes as whole thresholds of 1, which are subtracted; -1 at least."""
    membrane, fired = np.zeros(len(weights)), []
    for current in spikes @ weights.double().numpy().T:
        fired.append(np.floor(np.maximum(membrane + current, 0)))
        membrane = np.maximum(membrane + current - fired[-1], -1)
    return np.array(fired)


def test_neurons_count_the_spikes_that_a_simulation_step_by_step_counts():
    state = published()
    method = Lens(**SMALL).restore({name: tensor.numpy() for name, tensor in state.items()})
    torch.manual_seed(50)  # as the public data loader does before each frame
    drawn = torch.rand(200, SIDE**2)
    codes = np.stack([frame[:, :, 0].ravel() / np.float32(255) for frame in FRAMES])
    for number, code in enumerate(codes):
        inputs = (drawn < torch.from_numpy(code)).double().numpy()
        features = layer(state["feature_layer.w.weight"], inputs)
        outputs = layer(state["output_layer.w.weight"], features)
        counted = [found.values[0].tolist() for found in method.spikes(codes[number : number + 1])]
        assert counted == [spikes.sum(0).tolist() for spikes in (inputs, features, outputs)]
        assert features.max() > 1  # several spikes in one step
    scores = method.query(FRAMES)
    assert (scores > 0).any(1).all()
    assert np.array_equal(scores, method.match(codes))


def test_a_published_file_answers_by_its_two_weight_matrices_alone(tmp_path):
    state = published()
    torch.save(state, tmp_path / "lens.pth")
    method = Lens(**SMALL)
    networks.load_network(tmp_path / "lens.pth", method, None)  # a published file says nothing of where it comes from
    weights = {name: tensor.numpy() for name, tensor in state.items() if name.endswith("weight")}
    assert np.array_equal(method.query(FRAMES), Lens(**SMALL).restore(weights).query(FRAMES))
    assert set(method.state()) == set(weights)
    assert all(np.array_equal(array, weights[name]) for name, array in method.state().items())


def test_a_network_that_does_not_fit_is_refused():
    state = {name: tensor.numpy() for name, tensor in published().items()}
    outputs, features = "output_layer.w.weight", "feature_layer.w.weight"
    sizes = [(outputs, (PLACES, 8), 1), (outputs, (0, 9), 1), (features, (9, 16), np.nan), (features, (9, 20), 1)]
    for one in ({features: state[features]}, *(state | {name: np.full(*size, "f4")} for name, *size in sizes)):
        with pytest.raises(BadInput, match="feature_layer"):
            Lens(**SMALL).restore(one)
