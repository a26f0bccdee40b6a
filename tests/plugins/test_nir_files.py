"""VPRTempo networks as files of NIR: other simulators answer as we do, a wrong neuron is noticed, ours come back."""

from dataclasses import fields
from functools import partial
from typing import Any

import numpy as np
import pytest
from little import Prototypes, store_network

from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.errors import BadInput
from vprbench.methods.vprtempo.ensemble import VPRTempoEnsemble
from vprbench.methods.vprtempo.int8 import VPRTempoInt8
from vprbench.methods.vprtempo.method import VPRTempo
from vprbench.plugins import networks
from vprbench.plugins.rules import Journey

WORLD = Journey.draw(0)
SEEN = Images.from_arrays([*WORLD.references, *WORLD.queries])
RIDE = Dataset("ride", SEEN[: len(WORLD.places)], WORLD.places, SEEN, (np.array([0]),) * len(SEEN), {})
SMALL: dict[str, Any] = {"max_module": 10, "height": 20, "width": 20}
KINDS = {
    "spiking": (VPRTempo, {}),
    "linear": (VPRTempo, {"rules": "reference"}),
    "ensemble": (VPRTempoEnsemble, {"members": 2, "calibrated_scores": True, "query_rule": "linear"}),
}


@pytest.fixture(scope="module", params=KINDS)
def trained(request):
    kind, arguments = KINDS[request.param]
    return kind(**SMALL, **arguments).fit(RIDE.references, RIDE.places)


@pytest.fixture(scope="module")
def plain():
    return VPRTempo(**SMALL).fit(RIDE.references, RIDE.places)


def stored(method, folder):
    pytest.importorskip("nir", reason="the extra nir is not installed")
    path = folder / "net.nir"
    store_network(path, method, RIDE)
    return path


def loaded(path, method, kind=None):
    """Load a file into a new method with the arguments of another one."""
    arguments = {field.name: getattr(method, field.name) for field in fields(method) if field.init}
    new = (kind or type(method))(**arguments)
    networks.load_network(path, new, networks.describe_origin(new, arguments, RIDE))
    return new


def test_a_network_comes_back_from_nir_to_the_bit_and_is_loaded_with_8_bits(trained, plain, tmp_path):
    back = loaded(stored(trained, tmp_path), trained)
    assert np.array_equal(back.query(SEEN), trained.query(SEEN))
    assert {n: a.tobytes() for n, a in back.state().items()} == {n: a.tobytes() for n, a in trained.state().items()}
    (tmp_path / "net.nir").unlink()
    back = loaded(stored(plain, tmp_path), plain, VPRTempoInt8)
    assert np.allclose(back.query(SEEN), plain.query(SEEN), atol=0.02)


def test_another_simulator_names_the_same_places(trained, tmp_path):
    path = stored(trained, tmp_path)
    import nir
    import nir_simulators as simulators

    graph, own = nir.read(path), trained.query(SEEN)
    answers = simulators.scores(graph, simulators.plain, trained.encode(SEEN))
    spikes = "reset" in graph.metadata
    # of 46 inputs one may have two best places within a spike; nir-check asks 1000 for 99 %
    assert np.mean(answers.argmax(1) == own.argmax(1)) >= (0.97 if spikes else 1)
    assert np.abs(answers - own).max() <= (0.01 if spikes else 1e-4 * np.abs(own).max())
    assert simulators.knows_the_neurons(graph, simulators.plain)


def test_a_wrong_neuron_is_noticed(plain, tmp_path):
    path = stored(plain, tmp_path)
    import nir
    import nir_simulators as simulators

    graph = nir.read(path)
    assert graph.metadata["steps"] == 64
    for wrong in ({"reset": "zero"}, {"reset": "none"}, {"kept": 0.9}):
        assert not simulators.knows_the_neurons(graph, partial(simulators.plain, **wrong))


def test_a_damaged_file_and_another_programs_are_refused(plain, tmp_path):
    method, path = plain, stored(plain, tmp_path)
    import h5py

    with h5py.File(path, "r+") as file:
        del file["vprbench"]
    with pytest.raises(BadInput, match="no network that this version stored"):
        loaded(path, method)
    with h5py.File(path, "r+") as file:
        file.create_dataset("vprbench", (1 << 40,), "u1", chunks=True)  # which takes no room in the file
    with pytest.raises(BadInput, match="declares 1099511627776 bytes"):
        loaded(path, method)
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(BadInput, match="no network that this version stored"):
        loaded(path, method)


def test_what_is_no_circuit_and_a_missing_package_are_named_before_the_training(tmp_path, monkeypatch):
    monkeypatch.setattr("vprbench.plugins.nir_files.find_spec", lambda name: name)  # as if nir was installed
    for method, named in ((VPRTempo(rules="v1"), "method.silent_winner"), (Prototypes(), "Prototypes")):
        with pytest.raises(BadInput, match=named):
            networks.require_destination(networks.Files(save=tmp_path / "net.nir"), method)
    monkeypatch.setattr("vprbench.plugins.nir_files.find_spec", lambda name: None)
    with pytest.raises(BadInput, match=r"vprbench\[nir\]"):
        networks.require_destination(networks.Files(save=tmp_path / "net.nir"), VPRTempo(**SMALL))
