"""The benchmark of descriptors times what it says, needs no weights, and loses no row to another's failure."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
import torch
from torch import nn

from vprbench.api.neural import NeuralDescriptor
from vprbench.api.weights import Weights
from vprbench.cli import main
from vprbench.speed.descriptors import Settings, measure

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


def settings(**changed):
    small = {"frames": [[32, 48]], "places": 30, "fitted_places": 6, "batch": 4, "minimum_seconds": 0.0}
    return Settings(**{**small, "devices": ["cpu"], **changed})  # whether or not this machine has a GPU


def maker(**classes):
    made = []

    def make(name, device, **arguments):
        method = classes[name](weights=NO_FILE, **arguments)
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


@pytest.mark.extended
def test_the_command_prints_and_writes_the_table_and_names_an_unknown_method(tmp_path, capsys):
    assert main(["bench-descriptors", "quick=true", f"results={tmp_path}"]) == 0
    printed = capsys.readouterr().out
    assert "no number means anything" in printed
    assert (tmp_path / "descriptors.md").read_text() in printed
    assert "| hog " in printed
    assert main(["bench-descriptors", "methods=[hogg]", f"results={tmp_path}"]) == 2
    assert "method=hogg is unknown" in capsys.readouterr().err
