"""Conv-AP against a float64 version written from the key names of its files."""

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
from vprbench.methods.conv_ap import ConvAP
from vprbench.plugins import conformance, registry

TOLERANCE = 1e-4
CHANNELS = 6
SIZE = {"height": 96, "width": 160}  # 3x5 positions, of which the middle ones count in two quarters


def drawn(kind: str = "resnet50", n_inputs: int = 2048) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(4)
    return oracle.resnet_checkpoint(generator, kind, "backbone.model.", numbered=False) | {
        "aggregator.channel_pool.weight": torch.randn(CHANNELS, n_inputs, 1, 1, generator=generator) / 45,
        "aggregator.channel_pool.bias": 0.3 * torch.randn(CHANNELS, generator=generator),
    }


@pytest.fixture(scope="module")
def tensors() -> dict[str, torch.Tensor]:
    return drawn()


@pytest.fixture(scope="module")
def file(folder: Path, tensors: dict[str, torch.Tensor]) -> Path:
    return saved(folder / "resnet50_ConvAP.ckpt", tensors)


def saved(path: Path, tensors: dict[str, torch.Tensor]) -> Path:
    torch.save(tensors, path)
    return path


def method(path: Path, **arguments: Any) -> ConvAP:
    return ConvAP(weights=Weights("x", "", "", path=str(path)), **{"channels": CHANNELS, **SIZE, **arguments})


def expected(
    tensors: dict[str, torch.Tensor],
    images: Sequence[np.ndarray],
    *,
    kind: PillowImage.Resampling = PillowImage.Resampling.BICUBIC,
    parts_first: bool = False,
) -> np.ndarray:
    """Descriptors in float64; the options step into traps."""
    t = {name: tensor.double() for name, tensor in tensors.items()}
    descriptors = []
    for image in images:
        seen = np.asarray(PillowImage.fromarray(image).resize((160, 96), kind))
        features = oracle.resnet(tensors, "backbone.model.", oracle.imagenet(seen), "resnet50", numbered=False)[0]
        maps = torch.einsum("oc,chw->ohw", t["aggregator.channel_pool.weight"].flatten(1), features)
        maps = maps + t["aggregator.channel_pool.bias"][:, None, None]
        quarters = [
            maps[:, rows, across].mean((1, 2)) for rows in (slice(2), slice(1, 3)) for across in (slice(3), slice(2, 5))
        ]
        vector = torch.stack(quarters, 0 if parts_first else 1).flatten()
        descriptors.append((vector / vector.norm()).numpy())
    return np.array(descriptors)


def test_descriptors_are_those_of_the_published_layout(file: Path, tensors) -> None:
    images = drawn_images((131, 187), (96, 160))
    codes = encoded(method(file), *images)
    assert codes.shape == (2, 4 * CHANNELS)
    assert distance(codes, expected(tensors, images)) < TOLERANCE
    for trap in ({"kind": PillowImage.Resampling.BILINEAR}, {"parts_first": True}):
        assert distance(codes[:1], expected(tensors, images[:1], **trap)) > 10 * TOLERANCE


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("aggregator.channel_pool.weight", None, r"1 missing \(aggregator.channel_pool.weight\)"),
        ("backbone.model.layer4.2.bn3.bias", None, r"1 missing \(backbone.model.layer4.2.bn3.bias\)"),
        ("backbone.model.fc.weight", torch.zeros(2), r"1 unexpected \(backbone.model.fc.weight\)"),
        ("aggregator.channel_pool.bias", torch.zeros(7), r"7 channels: set method.channels=7, or give weights of 6"),
    ],
)
def test_a_file_that_differs_in_one_tensor_is_refused(name: str, value, told: str, folder: Path, tensors) -> None:
    changed = {key: tensor for key, tensor in tensors.items() if key != name} | ({} if value is None else {name: value})
    path = saved(folder / "changed.ckpt", changed)
    with pytest.raises(BadInput, match=told):
        method(path).load(path)


def test_the_blank_network_has_the_published_sizes() -> None:
    with torch.device("meta"):
        assert method(Path("none"), channels=1024).blank()(torch.zeros(1, 3, 32, 32)).shape == (1, 4096)


def test_every_rule_of_the_contract_is_kept(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vprbench.methods.conv_ap._BACKBONE", "resnet18")  # the suite describes many images
    file = saved(folder / "small.ckpt", drawn("resnet18", 512))
    network = method(file).load(file)
    monkeypatch.setattr(ConvAP, "load", lambda *_: network)  # read once, for the suite makes many methods
    config = composed("method=conv_ap", f"method.channels={CHANNELS}", "method.height=32", "method.width=32")
    config["weights"]["path"] = str(file)
    assert [str(result) for result in conformance.check(config) if result.state == "broken"] == []


def test_the_yaml_holds_the_arguments_and_defaults_of_the_class() -> None:
    made = registry.make_method(composed("method=conv_ap"))
    own = {field.name for field in fields(ConvAP) if field.init}
    assert set(registry.entries("method")["conv_ap"].options) == own
    default = ConvAP(weights=made.weights)  # type: ignore[attr-defined]
    assert {name: getattr(made, name) for name in own} == {name: getattr(default, name) for name in own}
    assert composed("method=conv_ap", "method.channels=128")["weights"]["file"] == "resnet50_ConvAP_128_2x2.ckpt"
