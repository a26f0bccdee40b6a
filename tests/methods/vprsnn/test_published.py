"""VPRSNN's published weights: every synapse finds its place, volts become millivolts, and nothing else is read."""

import numpy as np
import pytest
from little_vprsnn import SMALL, fitted, references

from vprbench.errors import BadInput, MissingData
from vprbench.methods.vprsnn.method import VPRSNN
from vprbench.methods.vprsnn.published import files_of, read_modules

INPUTS, NEURONS = 6, 4
THETA_VOLTS = np.array([0.02, 0.035, 0.0, 0.0615])


def random_weights(seed=0):
    return np.random.default_rng(seed).random((INPUTS, NEURONS))


def by_input(weights):
    """Rows as the authors' program writes them: all neurons of the first input, then those of the second."""
    return np.array([(*synapse, weight) for synapse, weight in np.ndenumerate(weights)])


def mixed(weights):
    return np.random.default_rng(1).permutation(by_input(weights))


def publish(folder, offset=0, weights=None, theta=THETA_VOLTS, kind="ne4_L25", ending=""):
    """Write a module in the published layout; returns its folder."""
    module = folder / f"weights_{kind}_offset{offset}{ending}"
    module.mkdir(parents=True)
    np.save(module / "XeAe.npy", by_input(random_weights()) if weights is None else weights)
    np.save(module / "theta_A.npy", theta)
    np.save(module / "AeAi.npy", np.zeros((NEURONS**2, 3)))
    return module


def read(folder):
    return read_modules(folder, INPUTS, NEURONS)


def refusal(folder, kind=BadInput):
    """The complaint about a folder; a file that is wrong is no file that is missing."""
    with pytest.raises(BadInput) as complaint:
        read(folder)
    assert complaint.type is kind
    assert "\n" not in str(complaint.value)
    return str(complaint.value)


@pytest.mark.parametrize("layout", [by_input, mixed, np.asfortranarray])
@pytest.mark.parametrize("number", [">f8", "<f4"])
def test_every_synapse_has_its_own_weight_whatever_the_layout(tmp_path, layout, number):
    weights = random_weights()
    publish(tmp_path, weights=layout(weights).astype(number))
    (module,) = read(tmp_path)
    assert np.array_equal(module.weights, weights.astype(number))
    assert module.weights.dtype == np.float64
    assert module.weights.flags.c_contiguous
    assert module.weights.flags.writeable
    assert module.theta_mv == pytest.approx([20, 35, 0, 61.5])


@pytest.mark.parametrize(("offsets", "ending"), [([0, 25, 50, 75, 100], ""), ([600, 625], "_S10")], ids=str)
def test_modules_are_read_in_the_order_of_their_first_places(tmp_path, offsets, ending):
    for offset in reversed(offsets):
        publish(tmp_path, offset, by_input(random_weights(offset)), ending=ending)
    (tmp_path / "weights_ne4_L25_offset125").touch()  # whatever else lies there is left alone
    (tmp_path / "random").mkdir()
    for offset, module in zip(offsets, read(tmp_path), strict=True):
        assert np.array_equal(module.weights, random_weights(offset))


@pytest.mark.parametrize(
    ("modules", "folder", "kind", "culprit"),
    [
        ([], "nowhere", MissingData, "nowhere"),
        ([], "", MissingData, "weights_ne400_L25_offset0"),
        ([{}, {"offset": 25}, {"offset": 75}], "", MissingData, "place 50, before weights_ne4_L25_offset75"),
        # two modules of the same places, or two networks
        ([{}, {"offset": 10}], "", BadInput, "weights_ne4_L25_offset0 and weights_ne4_L25_offset10"),
        ([{}, {"offset": 25, "kind": "ne8_L25"}], "", BadInput, "(weights_ne4_L25, weights_ne8_L25)"),
        ([{}, {"offset": 25, "ending": "_S10"}], "", BadInput, "(weights_ne4_L25, weights_ne4_L25_S10)"),
    ],
)
def test_modules_that_make_no_network_are_refused_by_name(tmp_path, modules, folder, kind, culprit):
    for module in modules:
        publish(tmp_path, **module)
    assert culprit in refusal(tmp_path / folder, kind)


def test_a_file_that_is_damaged_or_holds_no_plain_numbers_is_named(tmp_path):
    module = publish(tmp_path)
    whole = (module / "XeAe.npy").read_bytes()
    for damaged in (whole[:-1], b"", b"<!DOCTYPE html><title>Sign in</title>"):
        (module / "XeAe.npy").write_bytes(damaged)
        assert refusal(tmp_path).startswith(f"{module / 'XeAe.npy'} ")
    for name in ("theta_A.npy", "XeAe.npy"):
        for kind in ("<U3", "c16", "?", object):  # objects are pickled, and could run anything
            (module / "XeAe.npy").write_bytes(whole)
            np.save(module / name, np.zeros(NEURONS, kind))
            assert name in refusal(tmp_path)


def rows_but(row, source, neuron):
    rows = by_input(random_weights())
    rows[row, :2] = source, neuron
    return rows


def weights_but(value):
    weights = random_weights()
    weights[2, 3] = value
    return weights


@pytest.mark.parametrize(
    ("changed", "array", "culprit"),
    [
        *(("weights", np.zeros(shape), f"{shape}") for shape in ((23, 3), (24, 2), (4, 6), ())),
        *(("theta", np.zeros(shape), f"{shape}") for shape in ((5,), (4, 1))),
        *(
            ("weights", rows_but(0, *synapse), "XeAe.npy")
            for synapse in ((INPUTS, 0), (0, NEURONS), (-1, 0), (0.5, 0), (0, np.nan))
        ),
        ("weights", rows_but(5, 1, 2), "XeAe.npy"),  # one synapse is missing
        ("weights", rows_but(6, 1, 1), "XeAe.npy"),  # one comes twice
        *(("weights", weights_but(value), "XeAe.npy") for value in (np.nan, np.inf, -0.1)),
        *(("theta", [0.02, value, 0.02, 0.02], "theta_A.npy") for value in (np.nan, -0.02, 20.0)),
    ],
)
def test_shapes_synapses_weights_and_thresholds_that_cannot_be_are_refused(tmp_path, changed, array, culprit):
    publish(tmp_path, **{changed: np.asarray(array)})
    assert culprit in refusal(tmp_path)


@pytest.fixture
def folder(tmp_path):
    """The weights of a network that has learnt ten places, as published."""
    state = fitted(10).state()
    for number, (weights, theta) in enumerate(zip(state["weights"], state["theta"], strict=True)):
        publish(tmp_path, 600 + 5 * number, by_input(weights), theta / 1000, "ne24_L5")
    return tmp_path


def test_published_weights_are_taken_over_unchanged_and_assigned_by_the_last_presentations(folder):
    state, found = fitted(10).state(), fitted(10, published_weights=str(folder), recorded_presentations=12).state()
    assert np.array_equal(found["weights"], state["weights"])
    assert found["theta"] == pytest.approx(state["theta"])
    assert found["places"].tolist() == [[0, 1, 2, 3, 4], [5, 6, 7, 8, 9]]
    # Of 60 presentations, 10 an epoch, the last 12: places 3 and 4 of the second traverse, then two of every place.
    assert found["shown"].tolist() == [[2, 2, 2, 3, 3]] * 2
    # The same weights for the places in the other order: neurons speak for the images that they learnt.
    shown, places = references(10)
    others = (places // 5) * 5 + 4 - places % 5
    turned = VPRSNN(**{**SMALL, "epochs": 12}, published_weights=str(folder)).fit(shown, others)
    assert np.mean(turned.query(shown).argmax(1) == others) > 0.5


def test_the_files_of_published_weights_are_told_or_missed_and_others_have_none(folder):
    method = VPRSNN(**SMALL, published_weights=str(folder))
    assert [str(path.relative_to(folder)) for path in method.files()] == [
        f"weights_ne24_L5_offset{offset}/{name}" for offset in (600, 605) for name in ("XeAe.npy", "theta_A.npy")
    ]
    assert VPRSNN().files() == []
    for name in ("theta_A.npy", "XeAe.npy"):
        (folder / "weights_ne24_L5_offset605" / name).unlink()
        for ask in (method.files, lambda: files_of(folder), lambda: read(folder)):
            with pytest.raises(MissingData, match=rf"offset605/{name}"):
                ask()
