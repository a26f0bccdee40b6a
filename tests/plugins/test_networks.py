"""Stored networks: what is loaded answers as what was trained, and nothing else is ever loaded."""

from __future__ import annotations

import csv
import errno
import io
import json
import multiprocessing
import os
import pickle
import re
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, NoReturn, Self

import numpy as np
import numpy.typing as npt
import pytest
import torch
from little import (
    Lookup,
    Prototypes,
    destination,
    journey,
    pictures,
    replace_network_and_die,
)
from plugged_in import plugin, see_plugins
from safetensors.numpy import save_file
from small_plan import RUN
from trap import Trap

from vprbench.api.dataset import Dataset
from vprbench.api.method import Method
from vprbench.cli import main
from vprbench.errors import BadInput, NotFittedError
from vprbench.plugins import networks
from vprbench.run import rows
from vprbench.run.store import Store

WORLD = journey(8, 4)
LITTLE = ["method=prototypes", "dataset.places=12", "dataset.first_query_place=0", *RUN]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "nets" / "network.safetensors"


def fitted(method: Method, dataset: Dataset = WORLD) -> Method:
    return method.fit(dataset.references, dataset.places)


def store(path: Path, method: Method, dataset: Dataset = WORLD, replace: bool = False) -> Method:
    """Fit a method and store its network; returns the method."""
    where = destination(path, method, dataset, replace)
    networks.save(where, fitted(method, dataset), "0123", 12.34, 11.5)
    return method


def load(path: Path, method: Method, dataset: Dataset = WORLD, **arguments: Any) -> tuple[str, ...]:
    given = {name: value for name, value in vars(method).items() if not name.startswith("_")}
    return networks.load(path, method, networks.origin(method, {**given, **arguments}, dataset))


def refusal(path: Path, method: Method | None = None, dataset: Dataset = WORLD, **arguments: Any) -> str:
    """Return the one line that refuses a file, and see that the method was given nothing."""
    method = method or Prototypes()
    with pytest.raises(BadInput) as error:
        load(path, method, dataset, **arguments)
    with pytest.raises(NotFittedError):
        method.state()
    assert "\n" not in str(error.value)
    assert str(path) in str(error.value)
    return str(error.value)


# What is stored comes back


@dataclass
class Holding(Prototypes):
    """Stores any arrays."""

    arrays: Mapping[str, npt.NDArray[Any]] = field(default_factory=dict)

    def state(self) -> Mapping[str, npt.NDArray[Any]]:
        return self.arrays

    def restore(self, state: Mapping[str, npt.NDArray[Any]]) -> Self:
        self.arrays = state
        return self


ARRAYS = {
    "float32": np.array([[-np.inf, 1e-45], [-0.0, 0.1]], np.float32),
    "nothing": np.empty((0, 3)),
    "turned": np.arange(6, dtype=np.uint8).reshape(2, 3).T,
}


ORIGIN = networks.Origin("little", {}, "journey", 4, "f" * 64)


def test_arrays_come_back_bit_by_bit(tmp_path: Path) -> None:
    method = Holding(arrays=ARRAYS)
    networks.save(
        networks.Destination(tmp_path / "x.safetensors", False, ORIGIN, WORLD.references), method, "", 1.0, 1.0
    )
    networks.load(tmp_path / "x.safetensors", method, ORIGIN)
    for name, given in ARRAYS.items():
        back = method.arrays[name]
        assert (back.dtype, back.shape, back.tobytes()) == (given.dtype, given.shape, given.tobytes())


def test_a_loaded_network_gives_the_scores_of_the_trained_one_and_tells_its_run(path: Path) -> None:
    trained, loaded = store(path, Prototypes(seed=3)), Prototypes(seed=3)
    assert load(path, loaded) == ("loaded network: run 0123 trained it in 12.3 s",)
    assert np.array_equal(loaded.query(WORLD.queries), trained.query(WORLD.queries))


@pytest.mark.parametrize(
    ("other", "given", "name"),
    [
        ({"contrast": 2.0}, {}, "journey"),
        ({"device": "cuda"}, {}, "journey"),
        ({}, {"_target_": "elsewhere.Prototypes"}, "journey"),
        ({}, {"noise": 0.5, "seed": 0.0}, "journey"),
        ({}, {}, "voyage"),
    ],
    ids=["contrast", "device", "class", "way of writing numbers", "name of the dataset"],
)
def test_what_no_training_sees_may_differ(path: Path, other: dict[str, Any], given: dict[str, Any], name: str) -> None:
    trained, loaded = store(path, Prototypes()), Prototypes(**other)
    load(path, loaded, replace(WORLD, name=name), **given)
    assert np.array_equal(loaded.state()["means"], trained.state()["means"])


def test_a_method_may_load_what_another_of_the_same_kind_stored(path: Path) -> None:
    class First(Prototypes):
        stored_as: ClassVar[str] = "prototypes"

    class Second(First):
        pass

    trained, loaded = store(path, First()), Second()
    load(path, loaded)
    assert np.array_equal(loaded.state()["means"], trained.state()["means"])


# Networks made for something else


@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        ({"seed": 4}, "method.seed is 0 there and 4 here"),
        ({"noise": 0.25}, "method.noise is 0.5 there and 0.25 here"),
        ({"noise": None}, "method.noise is 0.5 there and null here"),
        ({"noise": "low"}, "method.noise is 0.5 there and low here"),
        ({"depth": 3}, "method.depth is unknown there and 3 here"),
        ({"seed": True}, "method.seed is 0 there and true here"),
    ],
)
def test_another_argument_is_named_with_both_values(path: Path, given: dict[str, Any], wanted: str) -> None:
    store(path, Prototypes())
    assert wanted in refusal(path, **given)


def test_a_network_that_is_older_than_an_argument_has_its_default(path: Path) -> None:
    where = destination(path, Prototypes(), WORLD)
    older = {name: value for name, value in where.origin.arguments.items() if name != "noise"}
    networks.save(replace(where, origin=replace(where.origin, arguments=older)), fitted(Prototypes()), "", 1.0, 1.0)
    load(path, Prototypes())
    assert "method.noise is unknown there and 0.25 here" in refusal(path, noise=0.25)


def test_every_difference_is_named_and_arguments_that_one_side_alone_has(path: Path) -> None:
    where = destination(path, Prototypes(), WORLD)
    older = replace(where.origin, arguments={**where.origin.arguments, "epochs": 4})
    networks.save(replace(where, origin=older), fitted(Prototypes()), "", 1.0, 1.0)
    line = refusal(path, Prototypes(noise=1.0, seed=2), journey(8, 5))
    differences = (r"noise is 0\.5 .* 1\.0", r"seed is 0 .* 2", "epochs is 4", r"4 places .*journey.* 5")
    assert all(re.search(difference, line) for difference in differences)


def test_the_network_of_another_method_is_named(path: Path) -> None:
    store(path, Prototypes())

    class Others(Prototypes):
        pass

    assert "Prototypes, not of Others" in refusal(path, Others())


@pytest.mark.parametrize(
    "dataset",
    [
        replace(WORLD, references=pictures([0, 1, 2, 9])),
        replace(WORLD, references=pictures([1, 0, 2, 3])),
        replace(WORLD, places=np.array([0, 1, 3, 2])),
    ],
    ids=["another image", "another order", "other places"],
)
def test_a_network_of_other_reference_images_is_refused_with_both_datasets(path: Path, dataset: Dataset) -> None:
    store(path, Prototypes())
    line = refusal(path, dataset=replace(dataset, name="voyage"))
    assert "journey there and voyage here" in line


# Files that are no stored network


def test_a_flipped_bit_anywhere_is_noticed(path: Path) -> None:
    store(path, Prototypes())
    whole = path.read_bytes()
    for position in range(len(whole)):
        spoilt = bytearray(whole)
        spoilt[position] ^= 1 << position % 8
        path.write_bytes(spoilt)
        refusal(path)


@pytest.mark.parametrize("length", [0, 5, 100, -1])
def test_a_file_that_was_cut_off_is_no_network_of_any_run(path: Path, length: int) -> None:
    store(path, Prototypes())
    assert networks.made_by(path) == "0123"
    path.write_bytes(path.read_bytes()[:length])
    assert "cannot be read" in refusal(path)
    assert networks.made_by(path) is None


@pytest.mark.parametrize("metadata", [None, {"format": "pt"}])
def test_a_file_of_another_program_is_named(tmp_path: Path, metadata: dict[str, str] | None) -> None:
    save_file({"means": np.zeros((4, 4), np.float32)}, tmp_path / "x.safetensors", metadata)
    assert "not stored by vprbench" in refusal(tmp_path / "x.safetensors")


def test_another_layout_is_named_with_both_versions(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(networks, "FORMAT", 7)
    store(path, Prototypes())
    monkeypatch.undo()
    assert "has layout 7, this program reads 1" in refusal(path)


def test_a_file_that_changed_since_its_hash_was_taken_is_refused(path: Path) -> None:
    store(path, Prototypes())
    with pytest.raises(BadInput, match="changed while the"):
        networks.load(path, Prototypes(), networks.origin(Prototypes(), {}, WORLD), "0" * 64)


def denied(*_: Any, **__: Any) -> NoReturn:
    raise PermissionError(errno.EACCES, "Permission denied")


@pytest.mark.parametrize(("name", "wanted"), [("folder.safetensors", "is no file"), ("network.pth", "denied")])
def test_what_is_no_file_of_a_network_is_refused_when_it_is_chosen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, wanted: str
) -> None:
    (tmp_path / "folder.safetensors").mkdir()
    (tmp_path / "network.pth").touch()
    monkeypatch.setattr(Path, "open", denied)
    with pytest.raises(BadInput, match=f"^load=.*{wanted}"):
        networks.chosen_files(None, str(tmp_path / name), False)


def test_a_tilde_is_the_home_folder(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store(path, Prototypes())
    monkeypatch.setenv("HOME", str(path.parent))
    files = networks.chosen_files("~/new.safetensors", f"~/{path.name}", False)
    assert (files.save, files.load) == (path.parent / "new.safetensors", path)


@pytest.mark.parametrize(
    "ask",
    [
        Method.state,
        lambda method: method.restore({}),
        lambda method: networks.load(Path("x.safetensors"), method, ORIGIN),
        lambda method: destination(Path("x.safetensors"), method, WORLD),
    ],
    ids=["state", "restore", "load", "prepare"],
)
def test_a_method_that_keeps_no_network_says_what_to_do(ask: Callable[[Method], object]) -> None:
    with pytest.raises(BadInput, match=r"^Lookup keeps no network.*save=.*load="):
        ask(Lookup(np.ones((1, 1), np.float32)))


# Before the training


@pytest.mark.parametrize(
    ("name", "force", "said"),
    [
        *[(name, False, r"\.safetensors") for name in ("network", "network.pth", "network.safetensors.bak")],
        ("there.safetensors", False, r"is there already.*\$\{seed\}.*force=true"),
        *[("folder.safetensors", force, "is a folder") for force in (False, True)],
        *[(f"{name}.safetensors", False, "cannot be written") for name in ("there/x", "there/deeper/x", "x" * 300)],
        ("denied.safetensors", False, r"save=.*cannot be written \(Permission denied\)"),
    ],
)
def test_a_file_that_cannot_be_stored_is_refused_before_the_training(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, force: bool, said: str
) -> None:
    (tmp_path / "folder.safetensors").mkdir()
    for file in ("there", "there.safetensors"):
        (tmp_path / file).touch()
    if name.startswith("denied"):
        monkeypatch.setattr(Path, "touch", denied)  # root, who may run these tests, has every right
    with pytest.raises(BadInput, match=said):
        destination(tmp_path / name, Prototypes(), WORLD, force)


# Writing


def only_file(path: Path) -> bool:
    return [found.name for found in path.parent.iterdir()] == [path.name]


def test_a_network_is_replaced_where_that_was_asked_for(path: Path) -> None:
    store(path, Prototypes(seed=0))
    trained = store(path, Prototypes(seed=1), replace=True)
    load(path, loaded := Prototypes(seed=1))
    assert np.array_equal(loaded.state()["means"], trained.state()["means"])
    assert only_file(path)


def test_a_file_that_appeared_during_the_training_stays(path: Path) -> None:
    where = destination(path, Prototypes(seed=1), WORLD)
    store(path, Prototypes())
    before = path.read_bytes()
    with pytest.raises(BadInput, match="is there already"):
        networks.save(where, fitted(Prototypes(seed=1)), "of another run", 1.0, 1.0)
    assert path.read_bytes() == before
    assert only_file(path)


def test_a_file_that_the_same_run_stored_elsewhere_during_the_training_is_replaced(path: Path) -> None:
    where = destination(path, Prototypes(seed=1), WORLD)
    store(path, Prototypes(seed=1))
    networks.save(where, fitted(Prototypes(seed=1)), "0123", 1.0, 1.0)
    assert only_file(path)


def test_what_a_killed_run_left_of_a_network_is_removed_after_a_day(path: Path) -> None:
    path.parent.mkdir(parents=True)
    old, new, other = (path.parent / f".partial-{i}-{name}" for i, name in enumerate([path.name, path.name, "notes"]))
    for left in (old, new, other):
        left.touch()
    for left in (old, other):
        os.utime(left, (0, 0))
    destination(path, Prototypes(), WORLD)
    assert sorted(path.parent.iterdir()) == [new, other]


def test_a_full_disk_leaves_the_old_network(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: int) -> NoReturn:
        raise OSError(errno.ENOSPC, "No space left on device")

    store(path, Prototypes())
    before = path.read_bytes()
    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(BadInput, match=r"stored.*No"):
        store(path, Prototypes(seed=1), replace=True)
    assert path.read_bytes() == before
    assert only_file(path)


def test_a_process_killed_at_any_step_of_writing_leaves_the_old_network_or_the_new_one(path: Path) -> None:
    processes = multiprocessing.get_context("forkserver")
    processes.set_forkserver_preload(["vprbench.plugins.networks"])
    store(path, Prototypes())
    found = []
    for step in range(50):
        writer = processes.Process(target=replace_network_and_die, args=(path, step), daemon=True)
        writer.start()
        writer.join()
        found.append(networks.made_by(path))
        if writer.exitcode == 0:
            break
    assert set(found) == {"0123", "new"}
    assert len(found) > 2


@pytest.mark.parametrize(
    "value", [np.array([None]), np.array(["a"]), torch.zeros(1), [1.0]], ids=lambda v: str(type(v))
)
def test_a_state_that_is_no_array_of_numbers_is_the_methods_mistake(path: Path, value: Any) -> None:
    where = destination(path, Prototypes(), WORLD)
    with pytest.raises(TypeError, match=r"Holding\.state\(\).*means"):
        networks.save(where, Holding(arrays={"means": value}), "", 1.0, 1.0)


# Published networks


def published(path: Path, content: Any, **options: Any) -> Path:
    torch.save(content, path, **options)
    return path


def read(path: Path) -> Mapping[str, npt.NDArray[Any]]:
    (note,) = networks.load(path, method := Holding(), ORIGIN)
    assert note.startswith("published network: neither")
    return method.arrays


LAYER = {"feature_layer.thr": torch.tensor([[0.5, 0.25]]), "feature_layer.w.weight": torch.eye(2)[:, :1]}


@pytest.mark.parametrize("modern", [True, False], ids=["zip", "before torch 1.6"])
def test_the_tensors_of_a_published_network_come_under_dotted_names(tmp_path: Path, modern: bool) -> None:
    content = {"model_0": LAYER, "model_1": {"output_layer.thr": torch.tensor([[2.0]])}}
    arrays = read(published(tmp_path / "x.pth", content, _use_new_zipfile_serialization=modern))
    assert {name: array.tolist() for name, array in arrays.items()} == {
        "model_0.feature_layer.thr": [[0.5, 0.25]],
        "model_0.feature_layer.w.weight": [[1.0], [0.0]],
        "model_1.output_layer.thr": [[2.0]],
    }


@pytest.mark.parametrize("kind", [torch.float64, torch.float16, torch.bfloat16, torch.int64])
def test_published_numbers_and_parameters_become_float32(tmp_path: Path, kind: torch.dtype) -> None:
    parameter = torch.nn.Parameter(torch.tensor([1, 2], dtype=kind), kind.is_floating_point)
    layers = {"model_0": torch.nn.ParameterDict({"thr": parameter}).state_dict(), "model_1": {"thr": parameter}}
    arrays = read(published(tmp_path / "x.pth", layers))
    assert [(array.dtype, array.tolist()) for array in arrays.values()] == [(np.float32, [1, 2])] * 2


@pytest.mark.parametrize(
    ("name", "said"), [("x.safetensors", "cannot be read as a stored network"), ("x.pth", "would have to run code")]
)
def test_a_file_with_code_in_it_is_refused_and_its_code_does_not_run(tmp_path: Path, name: str, said: str) -> None:
    (tmp_path / name).write_bytes(pickle.dumps({"model_0": {"thr": Trap(tmp_path / "sprung")}}))
    assert said in refusal(tmp_path / name)
    assert not (tmp_path / "sprung").exists()


@pytest.mark.parametrize(
    ("content", "wanted"),
    [
        ([torch.zeros(1)], "one list"),
        (torch.zeros(1), "one Tensor"),
        (torch.nn.Linear(2, 2), "tensors alone"),
        ({"model_0": {**LAYER, "epoch": 4}}, "model_0.epoch is of type int"),
        ({"model_0": None}, "model_0 is of type NoneType"),
        ({"model_0": {"deeper": {"thr": torch.zeros(1)}}}, "model_0.deeper is of type dict"),
        ({"model_0": {"thr": torch.zeros(2).to_sparse()}}, "model_0.thr is of type torch.sparse_coo"),
        ({"model_0": {"thr": torch.zeros(2, dtype=torch.complex64)}}, "torch.complex64"),
    ],
    ids=["list", "tensor", "module", "number", "nothing", "deeper", "sparse", "complex"],
)
def test_a_published_file_of_anything_but_state_dictionaries_is_refused(
    tmp_path: Path, content: Any, wanted: str
) -> None:
    assert wanted in refusal(published(tmp_path / "x.pth", content))


def test_a_method_that_cannot_use_what_was_published_says_so_with_the_path(tmp_path: Path) -> None:
    path = published(tmp_path / "x.pth", {"model_0": LAYER})
    assert "model_0.feature_layer.thr, model_0.feature_layer.w.weight came; wanted means" in refusal(path)


# The command line


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in a folder of its own, with the little method plugged in."""
    yaml = "_target_: little.Prototypes\nnoise: 0.5\ncontrast: 1.0\nseed: ${seed}\ndevice: ${device}"
    plugin(tmp_path / "plugin", "little", "little", {"prototypes": yaml})
    see_plugins(tmp_path / "plugin", monkeypatch)
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


Ask = Callable[..., dict[str, Any]]


@pytest.fixture
def ask(here: Path, capsys: pytest.CaptureFixture[str]) -> Ask:
    """Run with these options and return the JSON that is printed."""

    def asked(*options: str) -> dict[str, Any]:
        capsys.readouterr()
        assert main([*LITTLE, "output=json", *options]) == 0, capsys.readouterr().err
        return json.loads(capsys.readouterr().out)  # type: ignore[no-any-return]

    return asked


@pytest.fixture
def refused(here: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    def line(*options: str) -> str:
        capsys.readouterr()
        assert main([*LITTLE, *options]) == 2
        return capsys.readouterr().err.strip().splitlines()[-1]

    return line


@pytest.fixture
def untrainable(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> NoReturn:
        raise AssertionError("it was trained")

    monkeypatch.setattr(Prototypes, "fit", fail)


@pytest.fixture
def stored(ask: Ask) -> dict[str, Any]:
    """Train and store net.safetensors; returns what was printed."""
    return ask("save=net.safetensors")


ACCURACY = ("recall_at_1", "recall_at_5", "auc_pr_a", "average_precision_a", "queries")


def test_a_run_that_loads_trains_nothing_gives_the_same_scores_and_names_its_network(
    stored: dict[str, Any], untrainable: None, ask: Ask
) -> None:
    loaded, again = ask("load=net.safetensors"), ask("load=net.safetensors")
    assert [loaded[name] for name in ACCURACY] == [stored[name] for name in ACCURACY]
    first, second = [run.scores for run in Store(Path("results")).runs()]
    assert first is not None
    assert second is not None
    assert np.array_equal(first, second)
    assert (loaded["fit_seconds"], loaded["fit_compute_seconds"]) == (None, None)
    assert 0 < loaded["load_seconds"] < 5
    assert (stored["network"], stored["load_seconds"]) == (None, None)
    assert loaded["network"] == networks.chosen_files(None, "net.safetensors", False).sha256
    key = Path(stored["run_folder"]).name.removeprefix("prototypes-")
    assert any(note["text"].startswith(f"loaded network: run {key} trained it in ") for note in loaded["notes"])
    record = json.loads(Path(loaded["run_folder"], "run.json").read_text())
    assert record["config"]["load"] == "net.safetensors"
    assert (loaded["from_store"], again["from_store"]) == (False, True)
    assert ask()["run_folder"] == stored["run_folder"] != loaded["run_folder"]


def test_a_row_and_csv_of_a_loaded_run_say_so(
    stored: dict[str, Any], here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*LITTLE, "load=net.safetensors"]) == 0
    lines = capsys.readouterr().out.splitlines()
    at = next(number for number, line in enumerate(lines) if line.startswith("method "))
    head, row = lines[at : at + 2]
    assert row[head.index("fit s") :].startswith("loaded ")
    runs = list(Store(Path("results")).runs())
    (loaded,) = [line for line in csv.DictReader(io.StringIO(rows.csv(runs))) if line["network"]]
    assert (loaded["fit_seconds"], loaded["fit_compute_seconds"]) == ("", "")


def test_force_trains_again_and_another_network_in_the_same_file_is_another_run(
    stored: dict[str, Any], ask: Ask
) -> None:
    first, before = ask("load=net.safetensors"), Path("net.safetensors").read_bytes()
    assert ask("save=net.safetensors", "force=true")["from_store"] is False  # and took another time to train
    assert Path("net.safetensors").read_bytes() != before
    second = ask("load=net.safetensors")
    assert second["from_store"] is False
    assert second["network"] != first["network"]


def test_a_network_of_another_seed_is_refused_by_name(stored: dict[str, Any], refused: Callable[..., str]) -> None:
    assert "method.seed is 0 there and 1 here;" in refused("load=net.safetensors", "seed=1")


def test_nothing_is_trained_for_a_file_that_cannot_be_written(untrainable: None, refused: Callable[..., str]) -> None:
    Path("there.safetensors").write_text("mine")
    for save, wanted in (("net.pth", "ends in .safetensors"), ("there.safetensors", "is there already")):
        assert wanted in refused(f"save={save}")
    assert Path("there.safetensors").read_text() == "mine"


def test_a_run_is_answered_from_the_store_where_its_network_was_kept_and_else_made_again(
    ask: Ask, caplog: pytest.LogCaptureFixture
) -> None:
    ask()
    caplog.set_level("INFO")
    run = ask("save=net.safetensors")
    assert caplog.messages[0] == "prototypes is stored without its network: running again for save=net.safetensors"
    before = Path("net.safetensors").read_bytes()
    again = ask("save=net.safetensors")
    assert (run["from_store"], again["from_store"]) == (False, True)
    assert Path("net.safetensors").read_bytes() == before
    Path(run["run_folder"], "run.json").unlink()  # as where the run was killed when its network was stored
    assert [ask("save=net.safetensors")["from_store"] for _ in range(2)] == [False, True]


def test_a_run_in_the_store_does_not_take_the_network_of_another_run_for_its_own(
    stored: dict[str, Any], ask: Ask, refused: Callable[..., str]
) -> None:
    ask("seed=1")
    assert "save=net.safetensors is there already" in refused("save=net.safetensors", "seed=1")


def test_a_network_outlives_a_failure_at_the_queries(here: Path, ask: Ask, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> NoReturn:
        raise RuntimeError("no scores today")

    with monkeypatch.context() as patch:
        patch.setattr(Prototypes, "match", fail)
        assert main([*LITTLE, "save=net.safetensors"]) == 1
    assert ask("load=net.safetensors")["queries"] > 0


def test_a_training_that_fails_leaves_no_network(untrainable: None, here: Path) -> None:
    assert main([*LITTLE, "save=nets/net.safetensors"]) == 1
    assert list(Path("nets").iterdir()) == []


@pytest.mark.parametrize(
    ("name", "code", "stored"),
    [
        ("net-${seed}.safetensors", 0, ["net-0.safetensors", "net-1.safetensors"]),
        ("net.safetensors", 2, ["net.safetensors"]),
    ],
)
def test_cells_of_a_sweep_store_networks_under_their_own_names_and_none_replaces_another(
    here: Path, name: str, code: int, stored: list[str]
) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "vprbench", "-m", *LITTLE, "seed=0,1", f"save=nets/{name}"],
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == code, done.stderr
    assert sorted(path.name for path in Path("nets").iterdir()) == stored
    assert ("save=nets/net.safetensors is there already: give another name (in a sweep" in done.stderr) == (code == 2)
    keys = {record.parent.name for record in Path("results").rglob("run.json")}
    assert keys == {f"prototypes-{networks.made_by(path)}" for path in Path("nets").iterdir()}
