"""VPRSNN's published weights: every synapse finds its place, volts become millivolts, and nothing else is read."""

import numpy as np
import pytest
from little_vprsnn import SMALL, fitted, references

from vprbench.errors import BadInput, MissingData
from vprbench.methods.vprsnn.method import VPRSNN
from vprbench.methods.vprsnn.published import read_modules

INPUTS, NEURONS = 6, 4
THETA_VOLTS = np.array([0.02, 0.035, 0.0, 0.0615])


def random_weights(seed=0):
    return np.random.default_rng(seed).random((INPUTS, NEURONS))


def by_input(weights):
    """Rows as the authors' program writes them: all neurons of the first input, then those of the second."""
    return np.array([(*synapse, weight) for synapse, weight in np.ndenumerate(weights)])


def publish(folder, offset=0, weights=None, theta=THETA_VOLTS, kind="ne4_L25", ending=""):
    """Write a module in the published layout; returns its folder."""
    module = folder / f"weights_{kind}_offset{offset}{ending}"
    module.mkdir(parents=True)
    np.save(module / "XeAe.npy", by_input(random_weights()) if weights is None else weights)
    np.save(module / "theta_A.npy", theta)
    np.save(module / "AeAi.npy", np.zeros((NEURONS**2, 3)))
    return module


@pytest.mark.parametrize(("order", "number"), [("C", ">f8"), ("F", "<f4")])
def test_every_synapse_has_its_own_weight_whatever_the_layout(tmp_path, order, number):
    weights = random_weights()
    rows = np.random.default_rng(1).permutation(by_input(weights))
    publish(tmp_path, weights=np.asarray(rows, number, order))
    (module,) = read_modules(tmp_path, INPUTS, NEURONS)
    assert np.array_equal(module.weights, weights.astype(number))
    assert (module.weights.dtype, module.weights.flags.c_contiguous) == (np.float64, True)
    assert module.theta_mv == pytest.approx([20, 35, 0, 61.5])


@pytest.mark.parametrize(("offsets", "ending"), [([0, 25, 50, 75, 100], ""), ([600, 625], "_S10")], ids=str)
def test_modules_are_read_in_the_order_of_their_first_places(tmp_path, offsets, ending):
    for offset in reversed(offsets):
        publish(tmp_path, offset, by_input(random_weights(offset)), ending=ending)
    (tmp_path / "weights_ne4_L25_offset125").touch()  # other files and folders are left alone
    (tmp_path / "random").mkdir()
    for offset, module in zip(offsets, read_modules(tmp_path, INPUTS, NEURONS), strict=True):
        assert np.array_equal(module.weights, random_weights(offset))


@pytest.mark.parametrize(
    ("modules", "kind", "culprit"),
    [
        ([], MissingData, "weights_ne400_L25_offset0"),
        ([{}, {"offset": 25}, {"offset": 75}], MissingData, "place 50, then comes weights_ne4_L25_offset75"),
        # two modules of the same places, or two networks
        ([{}, {"offset": 10}], BadInput, "weights_ne4_L25_offset0 .* weights_ne4_L25_offset10"),
        ([{}, {"offset": 25, "kind": "ne8_L25"}], BadInput, "weights_ne4_L25, weights_ne8_L25"),
        ([{}, {"offset": 25, "ending": "_S10"}], BadInput, "weights_ne4_L25, weights_ne4_L25_S10"),
    ],
)
def test_modules_that_make_no_network_are_refused_by_name(tmp_path, modules, kind, culprit):
    for module in modules:
        publish(tmp_path, **module)
    with pytest.raises(kind, match=culprit):
        read_modules(tmp_path, INPUTS, NEURONS)


def rows_but(row, source, neuron):
    rows = by_input(random_weights())
    rows[row, :2] = source, neuron
    return rows


@pytest.mark.parametrize(
    ("name", "array"),
    [
        *(("XeAe.npy", np.zeros(shape)) for shape in ((23, 3), (24, 2), (4, 6), ())),
        *(("theta_A.npy", np.zeros(shape)) for shape in ((5,), (4, 1))),
        *(("XeAe.npy", rows_but(0, *synapse)) for synapse in ((INPUTS, 0), (-1, 0), (0.5, 0), (0, np.nan))),
        ("XeAe.npy", rows_but(5, 1, 2)),  # one synapse is missing
        *(("XeAe.npy", by_input(random_weights()) * [1, 1, value]) for value in (np.nan, np.inf, -0.1)),
        *(("theta_A.npy", np.array([0.02, value, 0.02, 0.02])) for value in (np.nan, -0.02, 20.0)),
        *(("theta_A.npy", np.zeros(NEURONS, kind)) for kind in ("<U3", object)),  # objects could run anything
        *(("XeAe.npy", content) for content in (b"", b"<!DOCTYPE html><title>Sign in</title>")),
    ],
)
def test_a_file_that_holds_anything_else_is_refused_by_name(tmp_path, name, array):
    module = publish(tmp_path)
    if isinstance(array, bytes):
        (module / name).write_bytes(array)
    else:
        np.save(module / name, array)
    with pytest.raises(BadInput, match=name):
        read_modules(tmp_path, INPUTS, NEURONS)


def test_published_weights_are_taken_over_unchanged_and_assigned_by_the_last_presentations(tmp_path):
    state = fitted(10).state()
    for number, (weights, theta) in enumerate(zip(state["weights"], state["theta"], strict=True)):
        publish(tmp_path, 600 + 5 * number, by_input(weights), theta / 1000, "ne24_L5")
    found = fitted(10, published_weights=str(tmp_path), recorded_presentations=12).state()
    assert np.array_equal(found["weights"], state["weights"])
    assert found["theta"] == pytest.approx(state["theta"])
    assert found["places"].tolist() == [[0, 1, 2, 3, 4], [5, 6, 7, 8, 9]]
    # Of 60 presentations, 10 an epoch, the last 12: places 3 and 4 of the second traverse, then two of every place.
    assert found["shown"].tolist() == [[2, 2, 2, 3, 3]] * 2
    # The same weights for the places in the other order: neurons speak for the images that they learnt.
    shown, places = references(10)
    others = (places // 5) * 5 + 4 - places % 5
    turned = VPRSNN(**{**SMALL, "epochs": 12}, published_weights=str(tmp_path)).fit(shown, others)
    assert np.mean(turned.query(shown).argmax(1) == others) > 0.5
    with pytest.raises(BadInput, match="2 modules, but the places make 1"):
        fitted(5, published_weights=str(tmp_path))
    assert [str(path.relative_to(tmp_path)) for path in turned.files()] == [
        f"weights_ne24_L5_offset{offset}/{name}" for offset in (600, 605) for name in ("XeAe.npy", "theta_A.npy")
    ]
    (tmp_path / "weights_ne24_L5_offset605" / "theta_A.npy").unlink()
    for read in (turned.files, lambda: turned.fit(shown, places)):
        with pytest.raises(MissingData, match=r"offset605/theta_A\.npy"):
            read()
