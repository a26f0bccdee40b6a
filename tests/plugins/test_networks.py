"""Stored networks: what is loaded answers as what was trained, and nothing else is ever loaded."""

import errno
import pickle
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch
from image_folders import answer
from little import Prototypes, journey, pictures, store_network
from safetensors.numpy import save_file
from trap import Trap

from vprbench.errors import BadInput, NotFittedError
from vprbench.plugins import networks

WORLD = journey(8, 4)
BIG = np.arange(6, dtype=">i4")
ORIGIN = networks.Origin(kind="little", arguments={}, dataset="journey", n_places=4, references="f" * 64)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "nets" / "network.safetensors"


def fitted(method):
    return method.fit(WORLD.references, WORLD.places)


def store(path, method, replace=False):
    """Fit a method and store its network; returns the method."""
    store_network(path, fitted(method), WORLD, replace)
    return method


def load(path, method, dataset=WORLD, **arguments):
    given = {name: value for name, value in vars(method).items() if not name.startswith("_")}
    return networks.load_network(path, method, networks.describe_origin(method, {**given, **arguments}, dataset))


def refusal(path, method=None, dataset=WORLD, **arguments):
    """Return the one line that refuses a file, and see that the method was given nothing."""
    method = method or Prototypes()
    line = answer(load, path, method, dataset, **arguments)
    with pytest.raises(NotFittedError):
        method.state()
    assert str(path) in line
    return line


@dataclass
class Holding(Prototypes):
    """Stores any arrays."""

    arrays: Mapping[str, npt.NDArray[Any]] = field(default_factory=dict)

    def state(self):
        return self.arrays

    def restore(self, state):
        self.arrays = state
        return self


Others = type("Others", (Prototypes,), {})
First = type("First", (Prototypes,), {"stored_as": "prototypes"})
Second = type("Second", (First,), {})


def test_arrays_come_back_bit_by_bit(path):
    arrays = {"odd": np.array([[-np.inf, 1e-45], [-0.0, 0.1]], np.float32).T, "none": np.empty((0, 3)), "big": BIG}
    method = Holding(arrays=arrays)
    path.parent.mkdir()
    networks.save_network(networks.Files(save=path), method, ORIGIN, WORLD.references)
    networks.load_network(path, method, ORIGIN)
    for name, given in arrays.items():
        wanted, back = given.astype(given.dtype.newbyteorder("<")), method.arrays[name]
        assert (back.dtype, back.shape, back.tobytes()) == (wanted.dtype, wanted.shape, wanted.tobytes())


def test_what_no_training_sees_may_differ(path):
    other = {"_target_": "elsewhere.Prototypes", "noise": 0.5, "seed": 0.0}
    for trained, loaded, given in (
        (Prototypes(), Prototypes(contrast=2.0, device="cuda"), {}),
        (Prototypes(), Prototypes(), other),
        (First(), Second(), {}),  # another class of the same kind
    ):
        store(path, trained, replace=True)
        notes = load(path, loaded, replace(WORLD, name="voyage"), **given)
        assert notes == ("loaded network: run 0123 trained it in 12.3 s",)
        assert np.array_equal(loaded.state()["means"], trained.state()["means"])


def test_every_difference_is_named_with_both_values(path):
    store(path, Prototypes())
    changed = [{"references": pictures(numbers)} for numbers in ([0, 1, 2, 9], [1, 0, 2, 3])]
    changed.append({"places": np.array([0, 1, 3, 2])})
    for method, dataset, given, wanted in (
        (Prototypes(), WORLD, {"noise": None}, ["method.noise is 0.5 there and null here"]),
        (Prototypes(), WORLD, {"noise": "low", "seed": 1}, ['there and "low" here', "seed is 0 there and 1 here"]),
        (Prototypes(), journey(8, 5), {}, ["4 places there (dataset journey) and 5 here"]),
        (Others(), WORLD, {}, ["Prototypes, not of Others"]),
        *((Prototypes(), replace(WORLD, name="voyage", **other), {}, ["journey there and voy"]) for other in changed),
    ):
        line = refusal(path, method, dataset, **given)
        assert [part for part in wanted if part not in line] == []


def test_a_damaged_file_is_refused(path):
    store(path, Prototypes())
    assert networks.read_run_key(path) == "0123"
    whole = path.read_bytes()
    for length in (0, 5, 100, -1):
        path.write_bytes(whole[:length])
        refusal(path)
        assert networks.read_run_key(path) is None
    for position in range(0, len(whole) - 64, 3):  # every one of the header
        path.write_bytes(whole[:position] + b"\xff" + whole[position + 1 :])
        refusal(path)
    for metadata in ({"format": "pt"}, {"vprbench": "{}"}):  # of another program, of another version
        save_file({"means": np.zeros((4, 4), np.float32)}, path, metadata)
        assert "no network that this version stored" in refusal(path)


def denied(*_, **__):
    raise PermissionError(errno.EACCES, "Permission denied")


def test_a_file_that_cannot_be_stored_is_refused_before_the_training(tmp_path):
    (tmp_path / "folder.safetensors").mkdir()
    for file in ("there", "there.safetensors"):
        (tmp_path / file).touch()

    for name, said in (
        ("network.pth", r"\.safetensors"),
        ("there.safetensors", r"is there already.*\$\{seed\}.*force=true"),
        ("folder.safetensors", "is there already"),
        ("there/x.safetensors", "cannot be written"),
    ):
        with pytest.raises(BadInput, match=f"save=.*{said}"):
            networks.require_destination(networks.Files(save=tmp_path / name), Prototypes())


# Published networks


LAYER = {"feature_layer.thr": torch.tensor([[0.5, 0.25]]), "feature_layer.w.weight": torch.eye(2)[:, :1]}


@pytest.mark.parametrize("modern", [True, False], ids=["zip", "before torch 1.6"])
def test_the_tensors_of_a_published_network_come_as_float32_under_dotted_names(tmp_path, modern):
    parameter = torch.nn.Parameter(torch.tensor([1, 2], dtype=torch.bfloat16))
    content = {"model_0": LAYER, "model_1": {"half": parameter, "whole": torch.tensor([1, 2])}}
    torch.save(content, tmp_path / "x.pth", _use_new_zipfile_serialization=modern)
    (note,) = networks.load_network(tmp_path / "x.pth", method := Holding(), ORIGIN)
    assert note.startswith("published network: neither")
    assert {array.dtype for array in method.arrays.values()} == {np.dtype(np.float32)}
    assert {name: array.tolist() for name, array in method.arrays.items()} == {
        "model_0.feature_layer.thr": [[0.5, 0.25]],
        "model_0.feature_layer.w.weight": [[1.0], [0.0]],
        "model_1.half": [1.0, 2.0],
        "model_1.whole": [1.0, 2.0],
    }


def test_a_published_file_of_anything_but_the_wanted_tensors_is_refused_and_its_code_does_not_run(tmp_path):
    for name, said in (("x.safetensors", "is damaged"), ("x.pth", "is damaged")):
        (tmp_path / name).write_bytes(pickle.dumps({"model_0": {"thr": Trap(tmp_path / "sprung")}}))
        assert said in refusal(tmp_path / name)
        assert not (tmp_path / "sprung").exists()
    for content, wanted in (
        ([torch.zeros(1)], "one list"),
        (torch.nn.Linear(2, 2), "tensors alone"),
        ({"model_0": {**LAYER, "epoch": 4}}, "model_0.epoch hold no plain tensor"),
        ({"model_0": {"thr": torch.zeros(2).to_sparse()}}, "model_0.thr hold"),
        ({"model_0": {"thr": torch.zeros(2, dtype=torch.complex64)}}, "model_0.thr hold"),
        ({"model_0": LAYER}, "model_0.feature_layer.thr, model_0.feature_layer.w.weight came; wanted means"),
    ):
        torch.save(content, tmp_path / "x.pth")
        assert wanted in refusal(tmp_path / "x.pth")
