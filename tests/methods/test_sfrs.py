"""SFRS against a float64 version written from the key names of its file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import backbones_oracle as oracle
import numpy as np
import pytest
import torch
from described_images import composed, distance, drawn_images, encoded
from PIL import Image as PillowImage

from vprbench.api.weights import Weights
from vprbench.errors import BadInput
from vprbench.methods.sfrs import SFRS
from vprbench.plugins import conformance, registry

MEAN = (0.48501960784313836, 0.4579568627450961, 0.4076039215686255)  # of RGB, 0 to 1, as its authors have it
TOLERANCE = 1e-4
CLUSTERS, COMPONENTS = 3, 8
OWN_SIZE = {"height": None, "width": None}


def drawn() -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(2)
    tensors = oracle.vgg16_checkpoint(generator, "base_model.base.")
    tensors["base_model.base.0.weight"] /= 60  # it sees levels
    return tensors | {
        "net_vlad.centroids": torch.randn(CLUSTERS, 512, generator=generator) / 512**0.5,
        "net_vlad.conv.weight": 4 * torch.randn(CLUSTERS, 512, 1, 1, generator=generator),
        "pca_layer.weight": torch.randn(COMPONENTS, CLUSTERS * 512, 1, 1, generator=generator),
        "pca_layer.bias": 0.5 * torch.randn(COMPONENTS, generator=generator),
    }


@pytest.fixture(scope="module")
def tensors() -> dict[str, torch.Tensor]:
    return drawn()


@pytest.fixture(scope="module")
def file(folder: Path, tensors: dict[str, torch.Tensor]) -> Path:
    torch.save(tensors, folder / "vgg16_netvlad.pth")
    return folder / "vgg16_netvlad.pth"


def method(path: Path, **arguments: Any) -> SFRS:
    return SFRS(weights=Weights("x", "", "", path=str(path)), **arguments)


def expected(
    tensors: dict[str, torch.Tensor],
    images: Sequence[np.ndarray],
    *,
    deviation: float = 1 / 255,
    cluster_fastest: bool = False,
    residuals: bool = True,
    last: int = 28,
) -> np.ndarray:
    """Descriptors in float64; the options step into traps."""
    t = {name: tensor.double() for name, tensor in tensors.items()}
    descriptors = []
    for image in images:
        x = torch.from_numpy(image.astype(np.float64)).permute(2, 0, 1)[None] / 255
        x = (x - torch.tensor(MEAN, dtype=torch.float64)[:, None, None]) / deviation
        local = oracle.vgg16(tensors, "base_model.base.", x, last)[0].flatten(1).T
        local = local / local.norm(dim=1, keepdim=True)
        shares = torch.softmax(local @ t["net_vlad.conv.weight"].flatten(1).T, dim=1)
        vlad = torch.zeros(CLUSTERS, 512, dtype=torch.float64)
        for k in range(CLUSTERS):
            centre = t["net_vlad.centroids"][k] if residuals else 0
            vlad[k] = (shares[:, k, None] * (local - centre)).sum(0)
            vlad[k] /= vlad[k].norm()
        vector = (vlad.T if cluster_fastest else vlad).flatten()
        whitened = t["pca_layer.weight"].flatten(1) @ (vector / vector.norm()) + t["pca_layer.bias"]
        descriptors.append((whitened / whitened.norm()).numpy())
    return np.array(descriptors)


def test_descriptors_are_those_of_the_published_layout(file: Path, tensors) -> None:
    images = drawn_images((64, 96), (49, 70))
    codes = encoded(method(file, **OWN_SIZE), *images)
    assert codes.shape == (2, COMPONENTS)
    assert distance(codes, expected(tensors, images)) < TOLERANCE


@pytest.mark.parametrize(
    "trap", [{"deviation": 0.226}, {"cluster_fastest": True}, {"residuals": False}, {"last": 29}], ids=str
)
def test_each_trap_gives_other_descriptors(trap: dict[str, Any], tensors) -> None:
    images = drawn_images((64, 96))
    assert distance(expected(tensors, images, **trap), expected(tensors, images)) > 20 * TOLERANCE


def test_images_are_seen_as_pillow_resizes_them_to_640x480(file: Path, tensors) -> None:
    (seen,) = drawn_images((90, 130))
    resized = np.asarray(PillowImage.fromarray(seen).resize((64, 48), PillowImage.Resampling.BILINEAR))
    assert distance(encoded(method(file, height=48, width=64), seen), expected(tensors, [resized])) < TOLERANCE
    assert method(file).target(768, 1024) == (480, 640)


@pytest.mark.parametrize("name", ["base_model.base.28.bias", "net_vlad.centroids", "pca_layer.bias"])
def test_a_missing_tensor_is_named_as_the_file_would_have_it(name: str, folder: Path, tensors) -> None:
    path = folder / "missing.pth"
    torch.save({key: tensor for key, tensor in tensors.items() if key != name}, path)
    with pytest.raises(BadInput, match=name):
        method(path).load(path)


def test_the_blank_network_has_the_published_sizes() -> None:
    with torch.device("meta"):
        blank = SFRS(weights=Weights("", "", "")).blank()
    shapes = {name: tuple(tensor.shape) for name, tensor in blank.state_dict().items()}
    assert shapes["pool.centroids"] == (64, 512)
    assert shapes["WPCA.0.weight"] == (4096, 32768, 1, 1)


def test_every_rule_of_the_contract_is_kept(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    network = method(file).load(file)
    monkeypatch.setattr(SFRS, "load", lambda *_: network)  # read once, for the suite makes many methods
    config = composed("method=sfrs", "method.height=16", "method.width=16")
    config["weights"]["path"] = str(file)
    assert [str(result) for result in conformance.check(config) if result.state == "broken"] == []


def test_the_yaml_holds_the_arguments_and_defaults_of_the_class() -> None:
    made = registry.make_method(composed("method=sfrs"))
    own = {field.name for field in fields(SFRS) if field.init}
    assert set(registry.entries("method")["sfrs"].options) == own
    default = SFRS(weights=made.weights)  # type: ignore[attr-defined]
    assert {name: getattr(made, name) for name in own} == {name: getattr(default, name) for name in own}
    assert default.weights.url == "https://github.com/yxgeee/OpenIBL/releases/download/v0.1.0-beta/vgg16_netvlad.pth"
