"""Stored networks: what is loaded answers as what was trained, and nothing else is ever loaded."""

import errno
import json
import pickle
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch
from image_folders import answer
from little import Lookup, Prototypes, journey, pictures, store_network
from little_runs import quiet_surroundings
from plugged_in import plugin, see_plugins
from safetensors.numpy import save_file
from small_plan import Apart
from trap import Trap

from vprbench.cli import main
from vprbench.errors import BadInput, NotFittedError
from vprbench.jobs import executors
from vprbench.plugins import networks
from vprbench.runs.store import Store

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
        (Prototypes(), WORLD, {"depth": 3}, ['method.depth is "unknown" there and 3 here']),
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


def test_what_is_no_file_of_a_network_is_refused_when_it_is_chosen(tmp_path, monkeypatch):
    (tmp_path / "folder.safetensors").mkdir()
    (tmp_path / "network.pth").touch()
    monkeypatch.setenv("HOME", str(tmp_path))
    files = networks.find_network_files("~/new.safetensors", "~/network.pth", False)
    assert (files.save, files.load) == (tmp_path / "new.safetensors", tmp_path / "network.pth")
    monkeypatch.setattr(Path, "open", denied)
    (tmp_path / "x.pth").touch()
    for name, wanted in (("folder", "load="), ("absent", "load="), ("network.txt", "load="), ("x.pth", "denied")):
        with pytest.raises(BadInput, match=wanted):
            networks.find_network_files(None, str(tmp_path / name), False)


def test_a_method_that_keeps_no_network_says_what_to_do():
    method, path = Lookup(np.ones((1, 1), np.float32)), Path("x.safetensors")
    for ask in (
        method.state,
        lambda: method.restore({}),
        lambda: networks.load_network(path, method, ORIGIN),
        lambda: networks.require_destination(networks.Files(save=path), method),
    ):
        with pytest.raises(BadInput, match=r"^Lookup keeps no network.*save=.*load="):
            ask()


def test_a_file_that_cannot_be_stored_is_refused_before_the_training(tmp_path, monkeypatch):
    (tmp_path / "folder.safetensors").mkdir()
    for file in ("there", "there.safetensors"):
        (tmp_path / file).touch()

    def refuse(name, said, force=True):
        with pytest.raises(BadInput, match=f"save=.*{said}"):
            networks.require_destination(networks.Files(save=tmp_path / name, replace=force), Prototypes())

    refuse("network.pth", r"\.safetensors")
    refuse("there.safetensors", r"is there already.*\$\{seed\}.*force=true", force=False)
    refuse("folder.safetensors", "is there already")
    for name in ("there/x.safetensors", "x" * 300 + ".safetensors"):
        refuse(name, "cannot be written")
    monkeypatch.setattr(tempfile, "TemporaryFile", denied)  # root, who may run these tests, has every right
    refuse("denied.safetensors", r"cannot be written \(Permission denied\)")


def test_a_file_stays_that_appeared_during_the_training_or_that_a_full_disk_cannot_replace(path, monkeypatch):
    store(path, Prototypes(seed=1))
    before = path.read_bytes()
    with pytest.raises(BadInput, match="is there already"):
        networks.save_network(networks.Files(save=path), fitted(Prototypes(seed=1)), ORIGIN, WORLD.references)
    monkeypatch.setattr(Path, "write_bytes", denied)  # as a full disk
    with pytest.raises(BadInput, match=r"stored.*denied"):
        store(path, Prototypes(seed=1), replace=True)
    assert path.read_bytes() == before
    assert [*path.parent.iterdir()] == [path]


def test_a_state_that_is_no_array_of_numbers_is_the_methods_mistake(path):
    for value in (np.array([None]), np.array(["a"]), torch.zeros(1), [1.0]):
        with pytest.raises(TypeError, match=r"Holding\.state\(\).*means"):
            networks.save_network(networks.Files(save=path), Holding(arrays={"means": value}), ORIGIN, WORLD.references)


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


# The command line


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Runs the little method on the command line, in a folder of its own; returns what is printed and the errors."""
    yaml = "_target_: little.Prototypes\nnoise: 0.5\ncontrast: 1.0\nseed: ${seed}\ndevice: ${device}"
    plugin(tmp_path / "plugin", "little", "little", {"prototypes": yaml})
    see_plugins(tmp_path / "plugin", monkeypatch)
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    quick = ("method=prototypes", "dataset.places=12", "dataset.first_query_place=0", "timing=none", "threads=1")

    def call(*options, code=0):
        capsys.readouterr()
        ended = main([*quick, *options])
        printed = capsys.readouterr()
        assert ended == code, printed.err
        return printed.out, printed.err

    with quiet_surroundings():
        yield call


@pytest.fixture
def ask(run):
    return lambda *options: json.loads(run("output=json", *options)[0])


def fail(*_):
    raise RuntimeError("not today")


@pytest.mark.extended
def test_a_run_that_loads_trains_nothing_gives_the_same_scores_and_names_its_network(run, ask, monkeypatch):
    stored = ask("save=net.safetensors")
    with monkeypatch.context() as patch:
        patch.setattr(Prototypes, "fit", fail)
        loaded, again = ask("load=net.safetensors"), ask("load=net.safetensors")
    accuracy = ("recall_at_1", "recall_at_5", "auc_pr_a", "average_precision_a", "queries")
    assert [loaded[name] for name in accuracy] == [stored[name] for name in accuracy]
    assert np.array_equal(*(np.asarray(run.scores) for run in Store(Path("results")).runs()))
    assert (loaded["fit_seconds"], loaded["fit_compute_seconds"], stored["load_seconds"]) == (None, None, None)
    assert 0 < loaded["load_seconds"] < 5
    assert loaded["network"] == networks.find_network_files(None, "net.safetensors", False).sha256
    key = Path(stored["run_folder"]).name.removeprefix("prototypes-")
    assert any(note["text"].startswith(f"loaded network: run {key} trained it in ") for note in loaded["notes"])
    assert (loaded["from_store"], again["from_store"]) == (False, True)
    assert ask()["run_folder"] == stored["run_folder"] != loaded["run_folder"]
    assert "method.seed is 0 there and 1 here;" in run("load=net.safetensors", "seed=1", code=2)[1]
    assert ask("save=net.safetensors", "force=true")["from_store"] is False  # and took another time to train
    second = ask("load=net.safetensors")  # another network in the same file is another run
    assert (second["from_store"], second["network"] == loaded["network"]) == (False, False)


@pytest.mark.extended
def test_a_run_is_answered_from_the_store_where_its_network_was_kept_and_else_made_again(run, ask, caplog):
    ask()
    caplog.set_level("INFO")
    made = ask("save=net.safetensors")
    assert caplog.messages[0].startswith("prototypes on synthetic is stored without its network")
    before = Path("net.safetensors").read_bytes()
    assert (made["from_store"], ask("save=net.safetensors")["from_store"]) == (False, True)
    assert Path("net.safetensors").read_bytes() == before
    Path(made["run_folder"], "run.json").unlink()  # as where the run was killed when its network was stored
    assert [ask("save=net.safetensors")["from_store"] for _ in range(2)] == [False, True]
    ask("seed=1")
    assert "net.safetensors is there already" in run("save=net.safetensors", "seed=1", code=2)[1]


@pytest.mark.extended
def test_a_network_outlives_a_failure_at_the_queries_and_a_failed_training_leaves_none(run, ask, monkeypatch):
    for step, there in (("match", ["net.safetensors"]), ("fit", [])):
        with monkeypatch.context() as patch:
            patch.setattr(Prototypes, step, fail)
            run(f"save={step}/net.safetensors", code=1)
        assert [path.name for path in Path(step).iterdir()] == there
    assert ask("load=match/net.safetensors")["queries"] > 0


@pytest.mark.extended
def test_cells_of_a_sweep_store_networks_under_their_own_names_and_none_replaces_another(run, monkeypatch):
    monkeypatch.setattr(executors, "run_in_child", Apart())
    run("-m", "seed=0,1", "save=nets/net-${seed}.safetensors")
    assert sorted(path.name for path in Path("nets").iterdir()) == ["net-0.safetensors", "net-1.safetensors"]
    errors = run("-m", "seed=2,3", "save=nets/net.safetensors", code=2)[1]
    assert "nets/net.safetensors is there already: give another name" in errors
    keys = {record.parent.name for record in Path("results").rglob("run.json")}
    assert keys == {f"prototypes-{networks.read_run_key(path)}" for path in Path("nets").iterdir()}
