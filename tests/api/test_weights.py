"""Published weights: the right file is found, nothing is run out of it, and it fits the network to the last name."""

from __future__ import annotations

import hashlib
import logging
import pickle
import re
import shlex
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from torch import nn
from trap import Trap

from vprbench.api import weights as module_under_test
from vprbench.api.weight_files import read_tensor, read_weights, state_dict
from vprbench.api.weights import Stated, Weights, find_weights, load_strictly, weights_folder, without_prefix
from vprbench.errors import BadInput
from vprbench.plugins.registry import checked

CONTENT = b"published"
SHA256 = hashlib.sha256(CONTENT).hexdigest()
WANTED = Weights(file="net.pth", licence="MIT", trained_on="MSLS")
LINKED = replace(WANTED, url="https://example.org/net.pth")
HERE = Path("net.pth")
TENSORS = {"weight": torch.arange(6.0).reshape(2, 3), "bias": torch.tensor([1.0, -1.0])}


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "cache"
    folder.mkdir()
    monkeypatch.setenv("VPRBENCH_WEIGHTS", str(folder))
    monkeypatch.delenv("VPRBENCH_OFFLINE", raising=False)
    return folder


@pytest.fixture
def downloads(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The downloads that were asked for; each gives CONTENT."""
    asked: list[Any] = []

    def fetch(url: str, destination: Path, **stated: Any) -> None:
        asked.append((url, destination, stated))
        destination.write_bytes(CONTENT)

    monkeypatch.setattr(module_under_test, "fetch", fetch)
    return asked


def of_content(**stated: Any) -> Weights:
    return replace(LINKED, stated={"net.pth": Stated(**stated)})


@pytest.mark.parametrize(
    ("variable", "value", "folder"),
    [("VPRBENCH_WEIGHTS", "~/nets", "nets"), ("XDG_CACHE_HOME", "~/.kept", ".kept/vprbench/weights")],
)
def test_the_environment_chooses_the_folder_which_is_in_the_cache_of_the_user_otherwise(
    variable: str, value: str, folder: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("VPRBENCH_WEIGHTS")
    monkeypatch.setenv(variable, str(Path(value).expanduser()) if variable.startswith("XDG") else value)
    assert weights_folder() == Path.home() / folder or not sys.platform.startswith("linux")


class TestConfiguration:
    @pytest.mark.parametrize("wrong", [{"pth": "b"}, {"stated": {"a": {"sha": "b"}}}, {"path": 3}])
    def test_what_weights_do_not_have_is_refused(self, wrong: dict[str, Any]) -> None:
        with pytest.raises(BadInput, match=r"method\.weights="):
            checked("method.weights", {"file": "a", "licence": "MIT", "trained_on": "b", **wrong}, Weights)


class TestFinding:
    def test_an_own_copy_in_the_home_folder_say_comes_before_everything(
        self, folder: Path, tmp_path: Path, downloads: list[Any], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setenv("HOME", str(tmp_path))
        monkeypatch.setenv("USERPROFILE", str(tmp_path))
        own = tmp_path / "own.pth"
        own.write_bytes(b"mine")
        (folder / "net.pth").write_bytes(CONTENT)
        for path in (str(own), "~/own.pth"):
            assert find_weights(replace(of_content(sha256=SHA256), path=path), "gcl") == own
        assert downloads == []

    @pytest.mark.parametrize("own", ["/nowhere/net.pth", "."])
    def test_an_own_copy_that_is_no_file_is_named(self, own: str) -> None:
        with pytest.raises(
            BadInput, match=rf"^method\.weights\.path={re.escape(own)} is no file that can be read: .*gcl"
        ):
            find_weights(replace(LINKED, path=own), "gcl")

    def test_a_file_in_the_folder_is_taken_if_it_is_the_stated_one(self, folder: Path, downloads: list[Any]) -> None:
        (folder / "net.pth").write_bytes(CONTENT)
        assert find_weights(of_content(size_bytes=9, sha256=SHA256), "gcl") == folder / "net.pth"
        for stated in ({"size_bytes": 7}, {"sha256": "0" * 64}):
            with pytest.raises(BadInput, match=r"net.pth has .*stated .*: delete it"):
                find_weights(of_content(**stated), "gcl")
        assert downloads == []

    @pytest.mark.parametrize(("file", "known"), [("net.pth", {"size_bytes": 9, "sha256": SHA256}), ("other.pth", {})])
    def test_a_missing_file_is_downloaded_with_what_is_stated_of_it(
        self, folder: Path, downloads: list[Any], file: str, known: dict[str, Any]
    ) -> None:
        stated = {file: Stated(size_bytes=9, sha256=SHA256)}
        assert find_weights(replace(LINKED, stated=stated), "gcl").read_bytes() == CONTENT
        assert downloads == [(LINKED.url, folder / "net.pth", {"size_bytes": None, "sha256": None, **known})]

    @pytest.mark.parametrize(
        ("wanted", "said"),
        [
            (LINKED, "VPRBENCH_OFFLINE .*https://example.org/net.pth"),
            (replace(WANTED, by_hand="log in at example.org"), "log in at example.org"),
        ],
        ids=["offline", "by hand"],
    )
    def test_what_no_program_may_or_can_fetch_is_said_to_a_person(
        self, wanted: Weights, said: str, folder: Path, downloads: list[Any], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setenv("VPRBENCH_OFFLINE", "1")
        with pytest.raises(BadInput, match=f"gcl needs net.pth, .*{folder}.*{said}.*method.weights.path=FILE"):
            find_weights(wanted, "gcl")
        assert downloads == []

    @pytest.mark.parametrize("name", ["../net.pth", "a/net.pth", "", ".."])
    def test_a_name_that_leaves_the_folder_is_refused(self, name: str, downloads: list[Any]) -> None:
        with pytest.raises(BadInput, match=r"method\.weights\.file="):
            find_weights(replace(LINKED, file=name), "gcl")
        assert downloads == []

    @pytest.mark.parametrize("stated", [{"size_bytes": 7}, {"sha256": "0" * 64}])
    def test_what_a_third_party_states_is_a_warning(
        self, stated: dict[str, Any], downloads: list[Any], caplog: pytest.LogCaptureFixture
    ) -> None:
        with caplog.at_level(logging.WARNING):
            find_weights(of_content(certain=False, **stated), "gcl")
        assert "by a third party" in caplog.text
        assert downloads[0][2] == {"size_bytes": None, "sha256": None}

    def test_a_folder_that_cannot_be_looked_into_is_named(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        def refuse(*_: Any, **__: Any) -> None:
            raise PermissionError(13, "Permission denied")

        monkeypatch.setattr(Path, "is_file", refuse)
        with pytest.raises(BadInput, match=r"cannot be read \(Permission denied\)"):
            find_weights(LINKED, "gcl")


def write_torch(content: Any, path: Path, *, zipped: bool = True) -> Path:
    torch.save(content, path, _use_new_zipfile_serialization=zipped)
    return path


class TestReading:
    @pytest.mark.parametrize("zipped", [True, False])
    @pytest.mark.parametrize("name", ["net.pth", "net.pt", "net.ckpt", "net.pth.tar"])
    def test_files_of_torch_are_read_nested_as_they_are(self, tmp_path: Path, name: str, zipped: bool) -> None:
        path = write_torch({"epoch": 3, "state_dict": TENSORS}, tmp_path / name, zipped=zipped)
        content = read_weights(path)
        assert content["epoch"] == 3
        assert torch.equal(content["state_dict"]["weight"], TENSORS["weight"])

    @pytest.mark.parametrize("name", ["model.safetensors", "model.bin"])
    def test_safetensors_are_read_whatever_the_name(self, tmp_path: Path, name: str) -> None:
        save_file(TENSORS, tmp_path / name)
        assert torch.equal(read_weights(tmp_path / name)["bias"], TENSORS["bias"])

    def test_a_zipped_file_stays_on_the_disk_until_it_is_used(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        modes = []
        load = torch.load
        monkeypatch.setattr(torch, "load", lambda *a, **options: modes.append(options["mmap"]) or load(*a, **options))
        read_weights(write_torch(TENSORS, tmp_path / "new.pth"))
        read_weights(write_torch(TENSORS, tmp_path / "old.pth", zipped=False))
        assert modes == [True, False]

    @pytest.mark.parametrize("how", ["zipped", "old", "bare pickle", "a program"])
    def test_a_hostile_file_is_refused_and_not_run(self, tmp_path: Path, how: str) -> None:
        path, mark = tmp_path / "net.pth", tmp_path / "mark"
        if how == "bare pickle":
            path.write_bytes(pickle.dumps(Trap(mark)))
        elif how == "a program":
            path.write_bytes(f"cos\nsystem\n(S'touch {mark}'\ntR.".encode())
        else:
            write_torch({"state_dict": TENSORS, "x": Trap(mark)}, path, zipped=how == "zipped")
        wanted = {"bare pickle": r"net\.pth", "a program": r"os\.system"}.get(how, "running code")
        with pytest.raises(BadInput, match=wanted) as error:
            read_weights(path)
        assert not mark.exists()
        assert "\n" not in str(error.value)

    @pytest.mark.parametrize("zipped", [True, False])
    @pytest.mark.parametrize(
        "value",
        [
            *(np.float64(0.852), np.float32(0.5), np.int64(-7), np.bool_(True), np.str_("vgg16")),
            *(np.array([0.25], ">f8")[0], np.array([0.5, 2.0]), np.array([[1, 2], [3, 4]], ">i2", order="F")),
            *(np.array([True]), np.array("ab")),
        ],
    )
    def test_numbers_of_numpy_beside_tensors_are_read(self, tmp_path: Path, value: Any, zipped: bool) -> None:
        path = write_torch({"recalls": {1: value}, "state_dict": TENSORS}, tmp_path / "net.pth", zipped=zipped)
        content = read_weights(path)
        found = np.asarray(content["recalls"][1])
        assert not value.ndim or found.dtype.newbyteorder("=") == value.dtype.newbyteorder("=")
        np.testing.assert_array_equal(found, value)
        assert torch.equal(content["state_dict"]["bias"], TENSORS["bias"])

    @pytest.mark.parametrize("module", [b"numpy.core.multiarray", b"numpy._core.multiarray"])
    def test_numpy_scalars_are_read_under_old_and_new_names(self, tmp_path: Path, module: bytes) -> None:
        path = write_torch({"best_score": np.float64(0.852)}, tmp_path / "net.pth", zipped=False)
        written = path.read_bytes()
        ours = next(name for name in (b"numpy._core.multiarray", b"numpy.core.multiarray") if name in written)
        path.write_bytes(written.replace(b"c" + ours + b"\n", b"c" + module + b"\n"))
        assert read_weights(path) == {"best_score": 0.852}

    @pytest.mark.parametrize(
        "value",
        [np.array([(1, 2.0)], "i4,f8")[0], np.datetime64("2026-01-01"), np.array([{}])],
        ids=["record", "date", "objects"],
    )
    def test_a_file_with_more_than_tensors_names_what_it_needs(self, tmp_path: Path, value: Any) -> None:
        path = write_torch({"state_dict": TENSORS, "best": value}, tmp_path / "net.pth")
        with pytest.raises(BadInput, match=r"holds more than tensors \(numpy\S*\)"):
            read_weights(path)

    @pytest.mark.parametrize(
        "content",
        [
            {"state_dict": TENSORS},
            {"model_state_dict": TENSORS, "optimizer_state_dict": {}},
            TENSORS,
        ],
        ids=["state_dict", "model_state_dict", "plain"],
    )
    def test_the_conversion_that_a_refusal_names_works(
        self, content: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        path = write_torch({**content, "best": np.array([{}])}, tmp_path / "net.pth")
        with pytest.raises(BadInput) as error:
            read_weights(path)
        named = re.search(r'(python -c ".*"), and give method\.weights\.path=(\S+)$', str(error.value))
        assert named is not None
        monkeypatch.chdir(tmp_path)
        _, _, program = shlex.split(named[1])
        exec(program, {})
        kept = state_dict(tmp_path / named[2], "model_state_dict", "state_dict")
        assert kept.keys() == TENSORS.keys()
        assert all(torch.equal(kept[name], values) for name, values in TENSORS.items())

    @pytest.mark.parametrize(
        ("content", "message"),
        [
            (b"", "is empty"),
            (b"\n<!DOCTYPE html><html>Sign in", "is a web page"),
            (b"<html>", "is a web page"),
            (b"PK\x03\x04" + bytes(100), "cannot be read as a file of torch"),
            (b"version https://git-lfs.github.com/spec/v1\noid", "is damaged, or no file of torch"),
            (bytes(2000), "net.pth"),
            (np.random.default_rng(0).bytes(5000), "net.pth"),
            (b"\x10\x00\x00\x00\x00\x00\x00\x00{", "cannot be read as safetensors"),
        ],
    )
    def test_what_holds_no_weights_is_refused(self, tmp_path: Path, content: bytes, message: str) -> None:
        (tmp_path / "net.pth").write_bytes(content)
        with pytest.raises(BadInput, match=message) as error:
            read_weights(tmp_path / "net.pth")
        assert "\n" not in str(error.value)

    @pytest.mark.parametrize("share", [0.1, 0.5, 0.99])
    @pytest.mark.parametrize("kind", ["new.pth", "old.pth", "net.safetensors"])
    def test_a_truncated_file_is_refused(self, tmp_path: Path, kind: str, share: float) -> None:
        path, tensors = tmp_path / kind, {"weight": torch.ones(100, 100)}
        if path.suffix == ".safetensors":
            save_file(tensors, path)
        else:
            write_torch(tensors, path, zipped=kind == "new.pth")
        path.write_bytes(path.read_bytes()[: int(path.stat().st_size * share)])
        with pytest.raises(BadInput, match=kind):
            read_weights(path)

    def test_a_file_that_is_not_there_is_named(self, tmp_path: Path) -> None:
        with pytest.raises(BadInput, match=r"net\.pth.*\(No"):
            read_weights(tmp_path / "net.pth")


class TestTensor:
    def test_a_file_of_one_tensor_gives_it(self, tmp_path: Path) -> None:
        assert torch.equal(read_tensor(write_torch(torch.arange(3.0), tmp_path / "centres.pt")), torch.arange(3.0))

    @pytest.mark.parametrize(
        ("read", "content"),
        [
            *((read_tensor, content) for content in (TENSORS, [torch.ones(1)], torch.ones(2, dtype=torch.complex64))),
            (read_weights, torch.ones(3)),
        ],
    )
    def test_anything_else_is_refused(self, tmp_path: Path, read: Callable[[Path], Any], content: Any) -> None:
        with pytest.raises(BadInput, match=r"centres\.pt holds one"):
            read(write_torch(content, tmp_path / "centres.pt"))


class TestStateDict:
    @pytest.mark.parametrize(
        "content", [TENSORS, {"state_dict": {"a": torch.ones(1)}, "model_state_dict": TENSORS}], ids=["top", "key"]
    )
    def test_the_first_key_that_is_there_counts_or_the_top(self, tmp_path: Path, content: dict[str, Any]) -> None:
        path = write_torch(content, tmp_path / "net.pth")
        assert list(state_dict(path, "model_state_dict", "state_dict")) == ["weight", "bias"]

    def test_parameters_come_as_tensors(self, tmp_path: Path) -> None:
        path = write_torch({"a": nn.Parameter(torch.ones(2))}, tmp_path / "net.pth")
        assert not state_dict(path)["a"].requires_grad

    @pytest.mark.parametrize(
        "content",
        [
            {"epoch": 3, "net": TENSORS},
            {"state_dict": 3},
            {"state_dict": {"nested": TENSORS}},
            {"state_dict": {"lr": 0.1}},
            {"state_dict": {}},
            {},
        ],
    )
    def test_anything_but_tensors_is_refused_with_what_is_there(self, tmp_path: Path, content: Any) -> None:
        path = write_torch(content, tmp_path / "net.pth")
        held = re.escape(", ".join(content))
        with pytest.raises(BadInput, match=rf"tensors alone under state_dict or its top \(it holds {held}\)"):
            state_dict(path, "state_dict")


class TestPrefixes:
    def test_leading_and_inner_parts_go(self) -> None:
        names = ["module.encoder.0.weight", "encoder.module.1.weight", "pool.module.module.conv.weight", "submodule.b"]
        kept = ["encoder.0.weight", "encoder.1.weight", "pool.conv.weight", "submodule.b"]
        assert list(without_prefix(dict.fromkeys(names, torch.ones(1)), "module.")) == kept
        assert list(without_prefix({"model.module.a": torch.ones(1)}, "module.", "model")) == ["a"]

    def test_two_names_that_become_one_are_refused(self) -> None:
        with pytest.raises(BadInput, match=r"a\.b.*a\.module\.b.*a\.b"):
            without_prefix({"a.b": torch.ones(1), "a.module.b": torch.ones(1)}, "module.")


class TestLoading:
    def test_a_module_computes_with_what_it_was_given(self) -> None:
        linear = nn.Linear(3, 2)
        load_strictly(linear, TENSORS, HERE)
        x = torch.tensor([[1.0, 2.0, 3.0]])
        assert linear(x).tolist() == [[0 + 2 + 6 + 1, 3 + 8 + 15 - 1]]

    @pytest.mark.parametrize(
        ("tensors", "wanted"),
        [
            ({"weight": TENSORS["weight"]}, r"^net\.pth.*1 missing \(bias\)"),
            ({**TENSORS, "extra": torch.ones(1)}, r"1 unexpected \(extra\)"),
            ({**TENSORS, **{f"x{i}": torch.ones(1) for i in range(5)}}, r"5 unexpected \(x0, x1, x2 and 2 more\)"),
            ({**TENSORS, "weight": torch.ones(3, 2)}, r"1 other \(weight real \(3, 2\), wanted real \(2, 3\)\)"),
            ({**TENSORS, "weight": torch.ones(2, 3, 1)}, r"weight real \(2, 3, 1\), wanted"),
            ({**TENSORS, "weight": torch.ones(1, 3)}, r"weight real \(1, 3\), wanted"),  # it would broadcast
            ({**TENSORS, "weight": torch.ones(2, 3, dtype=torch.int8)}, r"weight whole \(2, 3\), wanted real"),
            ({**TENSORS, "bias": torch.tensor([0.0, np.nan])}, r"1 not finite \(bias\)"),
            ({**TENSORS, "bias": torch.tensor([0.0, np.inf])}, r"1 not finite \(bias\)"),
            ({**TENSORS, "bias": torch.tensor([0.0, 1e300], dtype=torch.float64)}, r"1 not finite \(bias\)"),
        ],
    )
    def test_tensors_that_do_not_fit_are_refused_by_name(self, tensors: dict[str, torch.Tensor], wanted: str) -> None:
        with pytest.raises(BadInput, match=wanted):
            load_strictly(nn.Linear(3, 2), tensors, HERE)

    def test_names_and_patterns_may_be_optional(self) -> None:
        extra = {"mask_token": torch.ones(1), "norm.weight": torch.ones(1), "norm.bias": torch.ones(1)}
        linear = nn.Linear(3, 2)
        load_strictly(linear, {**TENSORS, **extra}, HERE, optional=("mask_token", "norm.*"))
        assert torch.equal(linear.bias, TENSORS["bias"])

    def test_what_the_module_has_is_never_optional(self) -> None:
        with pytest.raises(BadInput, match=r"1 missing \(bias\)"):
            load_strictly(nn.Linear(3, 2), {"weight": TENSORS["weight"]}, HERE, optional=("*",))

    @pytest.mark.parametrize("device", ["cpu", "meta"])
    def test_the_module_keeps_nothing_of_the_file_and_its_own_precision(self, device: str) -> None:
        given = {name: values.double() / 3 for name, values in TENSORS.items()}
        with torch.device(device):
            linear = nn.Linear(3, 2)
        load_strictly(linear, given, HERE)
        given["weight"].zero_()
        assert linear.weight.dtype == torch.float32
        assert torch.equal(linear.weight, (TENSORS["weight"].double() / 3).float())

    def test_a_module_on_meta_becomes_real(self) -> None:
        with torch.device("meta"):
            network = nn.Sequential(nn.Linear(3, 2), nn.BatchNorm1d(2)).eval()
        real = nn.Sequential(nn.Linear(3, 2), nn.BatchNorm1d(2)).eval()
        given = {name: values.double() for name, values in real.state_dict().items() if "num_batches" not in name}
        load_strictly(network, given, HERE)
        x = torch.ones(4, 3)
        assert torch.equal(network(x), real(x))
        assert network[1].num_batches_tracked.item() == 0
        assert network[0].weight.dtype == torch.float32
        assert network[0].weight.requires_grad

    def test_a_module_that_stays_on_meta_is_a_fault_of_its_own(self) -> None:
        with torch.device("meta"):
            module = nn.Linear(3, 2)
            module.register_buffer("mean", torch.ones(3), persistent=False)
        with pytest.raises(RuntimeError, match="Linear keeps mean on meta"):
            load_strictly(module, TENSORS, HERE)

    def test_strides_of_a_file_do_not_matter(self) -> None:
        given = torch.arange(36.0).reshape(2, 2, 3, 3).to(memory_format=torch.channels_last)
        with torch.device("meta"):
            conv = nn.Conv2d(2, 2, 3, bias=False)
        load_strictly(conv, {"weight": given}, HERE)
        assert conv.weight.is_contiguous()
        assert torch.equal(conv.weight, given)

    @pytest.mark.parametrize("given", [True, False])
    @pytest.mark.parametrize("tracks", [True, False])
    def test_the_counter_of_a_normalisation_may_be_there_or_not(self, given: bool, tracks: bool) -> None:
        norm = nn.BatchNorm2d(2)
        tensors = {name: values + 1 for name, values in norm.state_dict().items() if given or "num_" not in name}
        if not tracks:
            norm.register_buffer("num_batches_tracked", None)
        load_strictly(norm, tensors, HERE)
        assert norm.running_mean is not None
        assert norm.running_mean.tolist() == [1, 1]

    def test_scalars_keep_their_value(self) -> None:
        module = nn.ParameterDict({"dust_bin": nn.Parameter(torch.tensor(0.0))})
        load_strictly(module, {"dust_bin": torch.tensor(2.5, dtype=torch.float64)}, HERE)
        assert module["dust_bin"].item() == 2.5
