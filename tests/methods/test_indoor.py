"""EigenPlaces and SALAD of Indoor-VPR: the networks of their own tests, from files that wrap them once more."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import backbones_oracle as oracle
import numpy as np
import pytest
import torch
from backbones_oracle import Tensors
from described_images import drawn_images, image
from published_networks import PublishedNetwork, saved, with_checks
from torch.nn import functional

from vprbench.api.arrays import Image
from vprbench.api.weights import Weights
from vprbench.errors import BadInput
from vprbench.methods.indoor import EigenPlacesIndoor


def eigenplaces(kind: str = "resnet50", n_features: int = 2048, n_dimensions: int = 2048) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    return oracle.resnet_checkpoint(generator, kind, "model.backbone.") | {
        "model.aggregation.1.p": torch.tensor([2.4]),
        "model.aggregation.3.weight": torch.randn(n_dimensions, n_features, generator=generator),
        "model.aggregation.3.bias": 0.3 * torch.randn(n_dimensions, generator=generator),
    }


def salad() -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    dino = oracle.vit_checkpoint(generator) | {"mask_token": torch.randn(1, 128, generator=generator)}
    aggregator = oracle.salad_checkpoint(generator, 128, 7, 12, 10)
    parts = {"backbone.model": dino, "aggregator": aggregator}
    return {f"model.{part}.{name}": tensor for part, own in parts.items() for name, tensor in own.items()}


def expected_eigenplaces(t: Tensors, images: Sequence[Image]) -> np.ndarray:
    vectors = []
    for seen in images:
        features = functional.normalize(oracle.resnet(t, "model.backbone.", oracle.imagenet(seen), "resnet50"), dim=1)
        pooled = features.clamp(min=1e-6).pow(2.4).mean((2, 3)).pow(1 / 2.4)[0]
        vector = t["model.aggregation.3.weight"].double() @ pooled + t["model.aggregation.3.bias"].double()
        vectors.append((vector / vector.norm()).numpy())
    return np.stack(vectors)


def expected_salad(t: Tensors, images: Sequence[Image]) -> np.ndarray:
    """Images are seen as antialiased floats at the nearest multiples of 14."""
    vectors = []
    for seen in images:
        side = [round(length / 14) * 14 for length in seen.shape[:2]]
        floats = functional.interpolate(oracle.imagenet(seen), side, mode="bilinear", antialias=True)
        tokens = oracle.vit_tokens(t, "model.backbone.model.", floats)[0]
        vectors.append(oracle.salad(t, "model.aggregator.", tokens).numpy())
    return np.stack(vectors)


EIGENPLACES = PublishedNetwork(
    "eigenplaces_indoor",
    eigenplaces,
    drawn_images((64, 96), (64, 96)),
    2048,
    expected_eigenplaces,
    tolerance=1e-4,
    missing=["model.backbone.0.weight", "model.aggregation.1.p"],
    hidden_prefixes=("model.",),
    contract={"backbone": "ResNet18", "n_dimensions": 64, "height": 42, "width": 42},
    draw_for_contract=lambda: eigenplaces("resnet18", 512, 64),
)
SALAD = PublishedNetwork(
    "salad_indoor",
    salad,
    [image(50, 90), image(50, 90, 1)],
    7 * 12 + 10,
    expected_salad,
    tolerance=2e-5,
    missing=["model.aggregator.dust_bin", "model.backbone.model.norm.weight"],
    hidden_prefixes=("model.backbone.model.", "model."),
    contract={"height": 42, "width": 42},
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
