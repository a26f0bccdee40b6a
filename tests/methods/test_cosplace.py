"""CosPlace and EigenPlaces against float64 versions written from the key names of their files."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path

import backbones_oracle as oracle
import numpy as np
import pytest
import torch
from described_images import drawn_images, encoded
from published_networks import PublishedNetwork, saved, with_checks
from torch.nn import functional

from vprbench.api.arrays import Image
from vprbench.api.weights import Weights
from vprbench.errors import BadInput
from vprbench.methods.cosplace import CosPlace, EigenPlaces


def drawn(backbone: str, n_channels: int = 512, n_dimensions: int = 64) -> oracle.Tensors:
    draw = oracle.Draw(len(backbone))
    if backbone == "VGG16":
        tensors = oracle.vgg16_checkpoint(draw, "backbone.")
    else:
        tensors = oracle.resnet_checkpoint(draw, backbone.lower(), "backbone.")
    return tensors | {
        "aggregation.1.p": torch.tensor([2.4]),
        # What comes out of the pooling is a few hundredths.
        "aggregation.3.weight": draw.normal(n_dimensions, n_channels),
        "aggregation.3.bias": draw.normal(n_dimensions, scale=0.3),
    }


def expected(
    tensors: oracle.Tensors, image: Image, backbone: str = "VGG16", size: tuple[int, int] | None = None
) -> torch.Tensor:
    x = oracle.imagenet(image)
    x = x if size is None else functional.interpolate(x, size, mode="bilinear", antialias=True)
    if backbone == "VGG16":
        x = oracle.vgg16(tensors, "backbone.", x, 28)
    else:
        x = oracle.resnet(tensors, "backbone.", x, backbone.lower())
    pooled = oracle.gem(functional.normalize(x, dim=1), tensors["aggregation.1.p"])[0]
    return tensors["aggregation.3.weight"].double() @ pooled + tensors["aggregation.3.bias"].double()


NETWORK = PublishedNetwork(
    "cosplace",
    lambda: drawn("VGG16"),
    drawn_images((64, 96), (71, 53), (71, 53), (64, 96)),
    64,
    expected,
    arguments={"backbone": "VGG16", "n_dimensions": 64},
    tolerance=1e-4,
    wrong={"aggregation.3.weight": None, "backbone.30.weight": (3, 3), "aggregation.1.p": (512,)},
    options={
        "resized": ({"height": 48, "width": 80}, drawn_images((131, 187))[0], {"size": (48, 80)}),
        "black": ({}, np.zeros((32, 48, 3), np.uint8), {}),
    },
    refused=[("16 pixels", {}, (40, 15)), ("n_dimensions=64", {"n_dimensions": 128}, (64, 96))],
)


@with_checks(NETWORK)
def test_it_is_the_published_network(check, folder: Path) -> None:
    check(folder)


def test_descriptors_of_a_resnet_are_those_of_the_published_layout_of_the_smallest_image_too(folder: Path) -> None:
    small = NETWORK.images[0][:1, :2]
    for backbone, n_channels, n_dimensions in (("ResNet18", 512, 32), ("ResNet50", 2048, 256)):
        tensors = drawn(backbone, n_channels, n_dimensions)
        path = saved(folder / "resnet.pth", tensors)
        method = replace(NETWORK, arguments={"backbone": backbone, "n_dimensions": n_dimensions}).method(path)
        for seen in (NETWORK.images[0], small):
            codes = encoded(method, seen)
            np.testing.assert_allclose(codes, NETWORK.slowly(seen, tensors=tensors, backbone=backbone), atol=1e-4)


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
