"""CosPlace and EigenPlaces against float64 versions written from the key names of their files."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import backbones_oracle as oracle
import numpy as np
import pytest
import torch
from described_images import drawn_images
from published_networks import PublishedNetwork, saved, with_checks
from torch.nn import functional

from vprbench.api.images import Images
from vprbench.api.weights import Weights
from vprbench.errors import BadInput
from vprbench.methods.cosplace import CosPlace, EigenPlaces

CHANNELS = {"VGG16": 512, "ResNet18": 512, "ResNet50": 2048, "ResNet101": 2048, "ResNet152": 2048}


def drawn(backbone: str, n_dimensions: int = 64) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(len(backbone))
    n_channels = CHANNELS[backbone]
    if backbone == "VGG16":
        tensors = oracle.vgg16_checkpoint(generator, "backbone.")
    else:
        tensors = oracle.resnet_checkpoint(generator, backbone.lower(), "backbone.")
    return tensors | {
        "aggregation.1.p": torch.tensor([2.4]),
        # What comes out of the pooling is a few hundredths.
        "aggregation.3.weight": torch.randn(n_dimensions, n_channels, generator=generator),
        "aggregation.3.bias": 0.3 * torch.randn(n_dimensions, generator=generator),
    }


def expected(
    tensors: dict[str, torch.Tensor],
    images: Sequence[np.ndarray],
    backbone: str = "VGG16",
    *,
    resized=lambda x: x,
    before=lambda image: image,
    last: int = 28,
    unit_channels: bool = True,
    p: float | None = None,
    biased: bool = True,
) -> np.ndarray:
    """Descriptors in float64; the options after `resized` step into traps."""
    descriptors = []
    for image in images:
        x = resized(oracle.imagenet(before(image)))
        if backbone == "VGG16":
            x = oracle.vgg16(tensors, "backbone.", x, last)
        else:
            x = oracle.resnet(tensors, "backbone.", x, backbone.lower())
        if unit_channels:
            x = x / x.square().sum(1, keepdim=True).sqrt().clamp(min=1e-12)
        power = tensors["aggregation.1.p"].double().item() if p is None else p
        y = x.clamp(min=1e-6).pow(power).mean((2, 3)).pow(1 / power)
        y = y @ tensors["aggregation.3.weight"].double().T
        y = y + tensors["aggregation.3.bias"].double() if biased else y
        descriptors.append((y / y.norm())[0].numpy())
    return np.array(descriptors)


NETWORK = PublishedNetwork(
    "cosplace",
    lambda: drawn("VGG16"),
    drawn_images((64, 96), (71, 53), (71, 53), (64, 96)),
    64,
    expected,
    arguments={"backbone": "VGG16", "n_dimensions": 64},
    tolerance=1e-4,
    traps=[
        {"last": 30},  # with the last ReLU and pool, as GCL has VGG16
        {"last": 29},  # with the last ReLU
        {"unit_channels": False},  # as GCL has it
        {"p": 3.0},  # what the power starts from
        {"biased": False},
        {"before": lambda image: image[..., ::-1]},  # BGR
    ],
    missing=["backbone.28.bias", "aggregation.3.weight"],
    unexpected=["aggregation.3.running"],
    misshapen={"aggregation.3.weight": (64, 2048), "aggregation.1.p": (512,)},
    options={
        "resized": (
            {"height": 48, "width": 80},
            drawn_images((131, 187), (48, 80)),
            {"resized": lambda x: functional.interpolate(x, (48, 80), mode="bilinear", antialias=True)},
        ),
        "black": ({}, [np.zeros((32, 48, 3), np.uint8)], {}),
    },
    refused=[("16 pixels", {}, (40, 15)), ("n_dimensions=64", {"n_dimensions": 128}, (64, 96))],
    contract={"backbone": "ResNet18", "n_dimensions": 64, "height": 24, "width": 32},
    draw_for_contract=lambda: drawn("ResNet18"),
)
EIGENPLACES = replace(NETWORK, name="eigenplaces")


@with_checks(NETWORK)
def test_it_is_the_published_network(check, folder: Path) -> None:
    check(folder)


def test_eigenplaces_keeps_the_contract_too(folder: Path) -> None:
    assert EIGENPLACES.check_contract(folder) == set()


@pytest.mark.parametrize(
    ("backbone", "n_dimensions"), [("ResNet18", 32), ("ResNet50", 2048), ("ResNet101", 128), ("ResNet152", 512)]
)
def test_descriptors_of_a_resnet_are_those_of_the_published_layout(
    backbone: str, n_dimensions: int, folder: Path
) -> None:
    tensors, images = drawn(backbone, n_dimensions), NETWORK.images
    path = saved(folder / f"{backbone}.pth", tensors)
    codes = NETWORK.method(path, backbone=backbone, n_dimensions=n_dimensions).encode(Images.from_arrays(images[:1]))
    path.unlink()
    assert codes.shape == (1, n_dimensions)
    np.testing.assert_allclose(codes, expected(tensors, images[:1], backbone), rtol=0, atol=1e-4)


@pytest.mark.parametrize(
    ("kind", "backbone", "published"),
    [
        (CosPlace, "VGG16", {64, 128, 256, 512}),
        (CosPlace, "ResNet18", {32, 64, 128, 256, 512}),
        *((CosPlace, name, {32, 64, 128, 256, 512, 1024, 2048}) for name in ("ResNet50", "ResNet101", "ResNet152")),
        (EigenPlaces, "VGG16", {512}),
        (EigenPlaces, "ResNet18", {256, 512}),
        *((EigenPlaces, name, {128, 256, 512, 1024, 2048}) for name in ("ResNet50", "ResNet101")),
        (EigenPlaces, "ResNet152", set()),
    ],
)
def test_only_what_was_published_is_looked_for(
    kind, backbone: str, published: set[int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("VPRBENCH_WEIGHTS", str(tmp_path))
    (tmp_path / "there.pth").touch()
    found = set()
    for n_dimensions in (16, 32, 64, 128, 256, 512, 1024, 2048, 4096):
        method = kind(weights=Weights("there.pth", "", ""), backbone=backbone, n_dimensions=n_dimensions)
        with contextlib.suppress(BadInput):
            assert method.files() == (tmp_path / "there.pth",)
            found.add(n_dimensions)
    assert found == published


def test_a_refusal_tells_which_were_published() -> None:
    with pytest.raises(BadInput, match=r"n_dimensions=64: .* VGG16 512; ResNet18 256, 512"):
        EigenPlaces(weights=Weights("x.pth", "", ""), backbone="VGG16", n_dimensions=64).files()
