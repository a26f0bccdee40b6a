"""EigenPlaces and SALAD of Indoor-VPR: the networks of their own tests, from files that wrap them once more."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import backbones_oracle as oracle
import pytest
import torch
from described_images import composed, distance, drawn_images, encoded, image
from torch.nn import functional

from vprbench.api.weights import Weights
from vprbench.errors import BadInput
from vprbench.methods.indoor import EigenPlacesIndoor, SALADIndoor
from vprbench.plugins import conformance, registry

RELEASE = "https://github.com/Enrico-Chiavassa/Indoor-VPR/releases/download/v0.1.0/"
KINDS: dict[str, Any] = {"eigenplaces_indoor": EigenPlacesIndoor, "salad_indoor": SALADIndoor}

Tensors = dict[str, torch.Tensor]


def eigenplaces(kind: str = "resnet50", n_features: int = 2048, n_dimensions: int = 2048) -> Tensors:
    generator = torch.Generator().manual_seed(1)
    return oracle.resnet_checkpoint(generator, kind, "model.backbone.") | {
        "model.aggregation.1.p": torch.tensor([2.4]),
        "model.aggregation.3.weight": torch.randn(n_dimensions, n_features, generator=generator),
        "model.aggregation.3.bias": 0.3 * torch.randn(n_dimensions, generator=generator),
    }


def salad() -> Tensors:
    generator = torch.Generator().manual_seed(1)
    dino = oracle.vit_checkpoint(generator) | {"mask_token": torch.randn(1, 128, generator=generator)}
    aggregator = oracle.salad_checkpoint(generator, 128, 7, 12, 10)
    parts = {"backbone.model": dino, "aggregator": aggregator}
    return {f"model.{part}.{name}": tensor for part, own in parts.items() for name, tensor in own.items()}


@pytest.fixture(scope="module")
def tensors() -> dict[str, Tensors]:
    return {"eigenplaces_indoor": eigenplaces(), "salad_indoor": salad()}


@pytest.fixture(scope="module")
def files(folder: Path, tensors: dict[str, Tensors]) -> dict[str, Path]:
    for name, own in tensors.items():
        torch.save(own, folder / f"{name}.pth")
    return {name: folder / f"{name}.pth" for name in tensors}


def method(files: dict[str, Path], name: str, **arguments: Any) -> Any:
    return KINDS[name](weights=Weights("x", "", "", path=str(files[name])), **arguments)


def test_eigenplaces_describes_images_as_the_slow_computation(files, tensors) -> None:
    t = tensors["eigenplaces_indoor"]
    (seen,) = drawn_images((64, 96))
    features = functional.normalize(oracle.resnet(t, "model.backbone.", oracle.imagenet(seen), "resnet50"), dim=1)
    pooled = features.clamp(min=1e-6).pow(2.4).mean((2, 3)).pow(1 / 2.4)[0]
    vector = t["model.aggregation.3.weight"].double() @ pooled + t["model.aggregation.3.bias"].double()
    assert distance(encoded(method(files, "eigenplaces_indoor"), seen)[0], (vector / vector.norm()).numpy()) < 1e-4


def test_salad_sees_images_as_antialiased_floats_at_the_nearest_multiples_of_14(files, tensors) -> None:
    t = tensors["salad_indoor"]
    floats = functional.interpolate(oracle.imagenet(image(50, 90)), (56, 84), mode="bilinear", antialias=True)
    wanted = oracle.salad(t, "model.aggregator.", oracle.vit_tokens(t, "model.backbone.model.", floats)[0])
    assert distance(encoded(method(files, "salad_indoor"), image(50, 90))[0], wanted.numpy()) < 2e-5


@pytest.mark.parametrize(
    ("name", "tensor"),
    [
        ("eigenplaces_indoor", "backbone.0.weight"),
        ("eigenplaces_indoor", "aggregation.1.p"),
        ("salad_indoor", "aggregator.dust_bin"),
        ("salad_indoor", "backbone.model.norm.weight"),
    ],
)
def test_a_missing_tensor_is_named(name: str, tensor: str, folder: Path, tensors) -> None:
    path = folder / "missing.pth"
    torch.save({key: value for key, value in tensors[name].items() if key != f"model.{tensor}"}, path)
    with pytest.raises(BadInput, match=tensor):
        method({name: path}, name).load(path)


@pytest.mark.parametrize(("name", "told"), [("eigenplaces_indoor", "missing"), ("salad_indoor", r"names in model\.")])
def test_a_file_of_the_network_without_the_wrapper_is_refused(name: str, told: str, folder: Path, tensors) -> None:
    path = folder / "bare.pth"
    torch.save({key.removeprefix("model."): value for key, value in tensors[name].items()}, path)
    with pytest.raises(BadInput, match=told):
        method({name: path}, name).load(path)


@pytest.mark.parametrize(
    ("name", "arguments"),
    [("eigenplaces_indoor", {"backbone": "ResNet18", "n_dimensions": 64}), ("salad_indoor", {})],
)
def test_every_rule_of_the_contract_is_kept(
    name: str, arguments: dict[str, Any], files, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    torch.save(eigenplaces("resnet18", 512, 64), folder / "small.pth")  # the suite describes many images
    files = files | {"eigenplaces_indoor": folder / "small.pth"}
    network = method(files, name, **arguments).load(files[name])
    monkeypatch.setattr(KINDS[name], "load", lambda *_: network)  # read once, for the suite makes many methods
    config = composed(f"method={name}") | arguments | {"height": 42, "width": 42}
    config["weights"]["path"] = str(files[name])
    assert [str(result) for result in conformance.check(config) if result.state == "broken"] == []


@pytest.mark.parametrize(
    ("name", "file"),
    [
        ("eigenplaces_indoor", "eigenplaces_ResNet50_2048_GB1_BAI_5_10.pth"),
        ("salad_indoor", "salad_Dinov2_8448_GB1_10_25.pth"),
    ],
)
def test_the_yaml_holds_the_arguments_and_defaults_of_the_class(name: str, file: str) -> None:
    made = registry.make_method(composed(f"method={name}"))
    own = {field.name for field in fields(KINDS[name]) if field.init}
    assert set(registry.entries("method")[name].options) == own
    default = KINDS[name](weights=made.weights)  # type: ignore[attr-defined]
    assert {option: getattr(made, option) for option in own} == {option: getattr(default, option) for option in own}
    assert default.weights.url == RELEASE + file


def test_no_other_network_of_eigenplaces_was_trained_indoors() -> None:
    with pytest.raises(BadInput, match="EigenPlacesIndoor was published with ResNet50 2048"):
        EigenPlacesIndoor(weights=Weights("x", "", ""), backbone="ResNet18", n_dimensions=512).files()
