"""The benchmark of descriptors times what it says, needs no weights, and loses no row to another's failure."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
import torch
from torch import nn

from vprbench.api.descriptor import DescriptorMethod
from vprbench.api.neural import NeuralDescriptor
from vprbench.api.weights import Weights
from vprbench.cli import main
from vprbench.errors import BadInput
from vprbench.speed.descriptors import Case, DescriptorCell, Settings, cases, measure, randomised, text_of
from vprbench.speed.report import Failed

NO_FILE = Weights(file="none.pth", licence="", trained_on="")


class Two(nn.Module):
    def __init__(self):
        super().__init__()
        self.convolution = nn.Conv2d(3, 5, 3)
        self.norm = nn.BatchNorm2d(5)

    def forward(self, images):
        return self.norm(self.convolution(images)).amax((2, 3))


@dataclass(kw_only=True)
class Tiny(NeuralDescriptor):
    """Five numbers an image; its file is never read."""

    seen = ()

    def load(self, path):
        raise AssertionError("the benchmark loads nothing")

    def blank(self):
        with torch.device("meta"):
            return Two()

    def pixels(self, levels):
        self.seen += (tuple(levels.shape),)
        return super().pixels(levels)


FOURTEEN = type("Fourteen", (Tiny,), {"multiple": 14})
FIXED = type("Fixed", (Tiny,), {"fixed_size": True, "target": lambda *_: (20, 20)})


@dataclass
class Slow(DescriptorMethod):
    """One number an image, and a fit of its own."""

    n_references: int = 0

    def fit(self, references, places):
        self.n_references = len(references)
        return super().fit(references, places)

    def encode(self, images):
        return np.ones((len(images), 1), np.float32)


class Broken(Slow):
    def fit(self, *_):
        raise BadInput("no map today")


def settings(**changed):
    small = {"frames": [[32, 48]], "places": 30, "fitted_places": 6, "batch": 4, "minimum_seconds": 0.0}
    return Settings(**{**small, "devices": ["cpu"], **changed})  # whether or not this machine has a GPU


def maker(**classes):
    made = []

    def make(name, device, **arguments):
        method = classes[name](weights=NO_FILE, **arguments) if name == "tiny" else classes[name]()
        made.append(method)
        return method

    return make, made


@pytest.mark.parametrize(("network", "seen"), [(Tiny, (32, 48)), (FOURTEEN, (28, 42)), (FIXED, (20, 20))])
def test_a_network_is_timed_without_its_weights_at_the_nearest_size_that_it_takes(network, seen):
    make, made = maker(tiny=network)
    (cell,) = measure(settings(methods=["tiny"]), make).sections["descriptors"]
    assert (cell.seen, cell.n_dimensions, cell.places) == (seen, 5, 30)
    assert {shape[:2] for shape in made[-1].seen} == {(1, 3), (4, 3)}
    assert network is FIXED or {shape[2:] for shape in made[-1].seen} == {seen}
    assert [*cell.seconds] == ["encode one", "encode batch", "match one", "match batch"]
    assert all(len(laps) >= 3 and min(laps) > 0 for laps in cell.seconds.values())


def test_a_failure_is_a_row_and_a_method_that_learns_from_references_has_few_of_them():
    make, made = maker(broken=Broken, slow=Slow)
    report = measure(settings(methods=["broken", "slow"]), make)
    failed, cell = report.sections["descriptors"]
    assert failed == Failed({"method": "broken", "frame": "48x32"}, "no map today")
    assert (cell.places, made[-1].n_references, cell.seen) == (6, 6, None)
    assert "no map today" in text_of(report)
    seconds = {"encode one": [0.5, 0.25, 1.0], "encode batch": [0.4], "match one": [0.001], "match batch": [0.002]}
    cell = DescriptorCell(Case("m", (2, 3), "cpu", "float32", True), None, 7, 11, 4, seconds)
    assert [*cell.row().values()] == ["m", "3x2", "", "7", "500", "2", "10", "11", "1,000", "2,000"]


def test_on_a_gpu_networks_are_timed_in_all_numbers_and_what_takes_no_device_not_at_all():
    gpu = "cpu:0"  # to PyTorch the CPU, to the benchmark another device
    make, _ = maker(tiny=Tiny, slow=Slow)
    both = settings(methods=["tiny", "slow"], devices=["cpu", gpu], precisions=["float32", "bfloat16"])
    assert [(case.method, case.device, case.precision) for case in cases(both, make)] == [
        ("tiny", "cpu", "float32"),
        ("tiny", gpu, "float32"),
        ("tiny", gpu, "bfloat16"),
        ("slow", "cpu", "float32"),
    ]


def test_random_networks_are_those_of_their_seed_and_keep_their_activations_finite_and_alive():
    with torch.device("meta"):
        deep = nn.Sequential(*[layer for _ in range(20) for layer in (nn.Conv2d(32, 32, 3), nn.ReLU())])
    out = randomised(deep, 0)(torch.ones(1, 32, 48, 48))
    assert 1e-4 < float(out.detach().square().mean()) < 1e4
    first, again, other = (randomised(Two(), seed).convolution.weight.detach().numpy() for seed in (3, 3, 4))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_every_method_here_but_spiking_networks_is_measured_and_what_measures_nothing_is_refused(tmp_path, monkeypatch):
    assert {"sad", "hog", "netvlad", "megaloc"} <= set(Settings().methods)
    for folder, names in (("own", ("new", "vprtempo_new", "vprsnn")), ("other", ("strange",))):
        (tmp_path / folder / "method").mkdir(parents=True)
        for name in names:
            (tmp_path / folder / "method" / f"{name}.yaml").touch()
    folders = {"vprbench": tmp_path / "own", "other": tmp_path / "other"}
    monkeypatch.setattr("vprbench.plugins.entries.conf_folders", lambda: folders)
    assert Settings().methods == ["new"]
    wrong = {"frames": [[3]], "batch": 0, "minimum_seconds": math.inf, "precisions": ["half"], "devices": []}
    for name, given in wrong.items():
        with pytest.raises(BadInput, match=f"^{name}="):
            settings(**{name: given})


def test_the_command_prints_and_writes_the_table_and_names_an_unknown_method(tmp_path, capsys):
    assert main(["bench-descriptors", "quick=true", f"results={tmp_path}"]) == 0
    printed = capsys.readouterr().out
    assert "no number means anything" in printed
    assert (tmp_path / "descriptors.md").read_text() in printed
    assert "| hog " in printed
    assert main(["bench-descriptors", "methods=[hogg]", f"results={tmp_path}"]) == 2
    assert "method=hogg is unknown" in capsys.readouterr().err
