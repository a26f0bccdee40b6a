"""EigenPlaces and SALAD of Indoor-VPR: the networks of their own tests, from files that wrap them once more."""

from __future__ import annotations

from pathlib import Path

import backbones_oracle as oracle
import pytest
import torch
from backbones_oracle import Draw, Tensors, prefixed
from described_images import drawn_images, image
from published_networks import PublishedNetwork, saved, with_checks
from torch.nn import functional

from vprbench.api.arrays import Image
from vprbench.api.weights import Weights
from vprbench.errors import BadInput
from vprbench.methods.indoor import EigenPlacesIndoor


def eigenplaces() -> Tensors:
    draw = Draw(1)
    tensors = oracle.resnet_checkpoint(draw, "resnet50", "backbone.") | {
        "aggregation.1.p": torch.tensor([2.4]),
        "aggregation.3.weight": draw.normal(2048, 2048),
        "aggregation.3.bias": draw.normal(2048, scale=0.3),
    }
    return prefixed("model.", tensors)


def salad() -> Tensors:
    draw = Draw(1)
    tensors = prefixed("backbone.model.", oracle.vit_checkpoint(draw))
    return prefixed("model.", tensors | prefixed("aggregator.", oracle.salad_checkpoint(draw, 7, 12, 10)))


def expected_eigenplaces(t: Tensors, seen: Image) -> torch.Tensor:
    features = functional.normalize(oracle.resnet(t, "model.backbone.", oracle.imagenet(seen), "resnet50"), dim=1)
    pooled = oracle.gem(features, t["model.aggregation.1.p"])[0]
    return t["model.aggregation.3.weight"].double() @ pooled + t["model.aggregation.3.bias"].double()


def expected_salad(t: Tensors, seen: Image) -> torch.Tensor:
    """Images are seen as antialiased floats at the nearest multiples of 14."""
    side = [round(length / 14) * 14 for length in seen.shape[:2]]
    floats = functional.interpolate(oracle.imagenet(seen), side, mode="bilinear", antialias=True)
    return oracle.salad(t, "model.aggregator.", oracle.vit_tokens(t, "model.backbone.model.", floats)[0])


EIGENPLACES = PublishedNetwork(
    "eigenplaces_indoor",
    eigenplaces,
    drawn_images((64, 96), (64, 96)),
    2048,
    expected_eigenplaces,
    tolerance=1e-4,
)
SALAD = PublishedNetwork(
    "salad_indoor",
    salad,
    [image(50, 90), image(50, 90, 1)],
    7 * 12 + 10,
    expected_salad,
    tolerance=2e-5,
)


@with_checks(EIGENPLACES, SALAD)
def test_it_is_the_published_network(check, folder: Path) -> None:
    check(folder)


@pytest.mark.parametrize("network", [EIGENPLACES, SALAD])
def test_a_file_of_the_network_without_the_wrapper_is_refused(network: PublishedNetwork, folder: Path) -> None:
    bare = {name.removeprefix("model."): tensor for name, tensor in network.tensors.items()}
    assert "model." in network.refusal(saved(folder / "bare.pth", bare))


def test_no_other_network_of_eigenplaces_was_trained_indoors() -> None:
    with pytest.raises(BadInput, match=r"published with ResNet50 2048\b"):
        EigenPlacesIndoor(weights=Weights("x", "", ""), backbone="ResNet18", n_dimensions=512).files()
