"""DINOv2 as a descriptor: equal to a slow computation from the tensors of a file by their published names."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch
from backbones_oracle import Tensors, imagenet, vit_checkpoint, vit_tokens
from described_images import composed, distance, encoded, image
from PIL import Image as PillowImage

from vprbench.api.weights import Weights
from vprbench.errors import BadInput
from vprbench.methods.dinov2 import DINOv2
from vprbench.plugins import conformance, registry

TOLERANCE = 1e-5


@pytest.fixture(scope="module")
def tensors() -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    return {**vit_checkpoint(generator), "mask_token": torch.randn(1, 128, generator=generator)}


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory, tensors: Tensors) -> Path:
    return saved(tmp_path_factory.mktemp("dinov2") / "small_pretrain.pth", tensors)


def saved(path: Path, tensors: Tensors) -> Path:
    torch.save(dict(tensors), path)
    return path


def method(path: Path, **arguments: Any) -> DINOv2:
    weights = Weights(file=path.name, licence="none", trained_on="nothing", path=str(path))
    return DINOv2(weights=weights, **{"height": None, "width": None, **arguments})


def expected(tensors: Tensors, image: npt.NDArray[np.uint8], pooling: str = "cls", **how: Any) -> npt.NDArray[Any]:
    tokens = vit_tokens(tensors, "", imagenet(image), **how)[0]
    vector = {
        "cls": lambda: tokens[0],
        "mean": lambda: tokens[1:].mean(0),
        "gem": lambda: (tokens[1:].clamp(min=1e-6) ** 3).mean(0) ** (1 / 3),
    }[pooling]()
    return (vector / vector.norm()).numpy()


# Values


@pytest.mark.parametrize("pooling", ["cls", "mean", "gem"])
def test_images_of_two_sizes_have_the_descriptors_of_the_slow_computation(
    file: Path, tensors: Tensors, pooling: Any
) -> None:
    images = [image(56, 98), image(42, 70, 1), image(42, 70, 2)]
    codes = encoded(method(file, pooling=pooling), *images)
    assert distance(codes, np.stack([expected(tensors, seen, pooling) for seen in images])) < TOLERANCE


def test_at_the_size_of_the_position_embedding_it_is_taken_as_it_is(file: Path, tensors: Tensors) -> None:
    assert distance(encoded(method(file), image(70, 70)), expected(tensors, image(70, 70))) < TOLERANCE


def test_a_gate_in_place_of_gelu_is_told_from_the_file(tmp_path: Path) -> None:
    tensors = vit_checkpoint(torch.Generator().manual_seed(2), swiglu=True)
    path = saved(tmp_path / "gate.pth", tensors)
    assert (
        distance(encoded(method(path, backbone="vitg14"), image(42, 56)), expected(tensors, image(42, 56))) < TOLERANCE
    )


def test_without_the_final_norm_these_values_would_be_others(tensors: Tensors) -> None:
    seen = image(56, 98)
    assert distance(expected(tensors, seen), expected(tensors, seen, final_norm=False)) > 100 * TOLERANCE


def test_the_mask_token_of_the_training_changes_nothing(file: Path, tensors: Tensors, tmp_path: Path) -> None:
    without = saved(tmp_path / "without.pth", {name: t for name, t in tensors.items() if name != "mask_token"})
    assert np.array_equal(encoded(method(file), image(42, 42)), encoded(method(without), image(42, 42)))


def test_an_image_is_seen_at_the_nearest_multiples_of_14(file: Path, tensors: Tensors) -> None:
    seen = np.asarray(PillowImage.fromarray(image(50, 90)).resize((84, 56), PillowImage.Resampling.BILINEAR))
    assert distance(encoded(method(file), image(50, 90)), expected(tensors, seen)) < TOLERANCE


def test_by_default_images_are_seen_at_322_pixels(file: Path) -> None:
    weights = Weights(file=file.name, licence="none", trained_on="nothing", path=str(file))
    assert DINOv2(weights=weights).target(480, 640) == (322, 322)


def test_descriptors_are_unit_vectors_that_neither_batch_nor_repetition_changes(file: Path) -> None:
    images = [image(42, 56, seed) for seed in range(3)]
    codes = encoded(method(file), *images)
    assert codes.dtype == np.float32
    assert np.allclose(np.linalg.norm(codes, axis=1), 1, atol=1e-6)
    assert np.array_equal(codes, encoded(method(file), *images))
    assert distance(codes, np.concatenate([encoded(method(file), one) for one in images])) < 1e-6
    assert distance(codes[0], codes[1]) > 1e-3


# Files


def refusal(path: Path) -> str:
    with pytest.raises(BadInput) as error:
        encoded(method(path), image(42, 42))
    assert "\n" not in str(error.value)
    assert str(path) in str(error.value)
    return str(error.value)


@pytest.mark.parametrize(
    "name", ["norm.weight", "cls_token", "blocks.1.ls2.gamma", "blocks.1.attn.qkv.bias", "pos_embed"]
)
def test_a_missing_tensor_is_named(tensors: Tensors, tmp_path: Path, name: str) -> None:
    kept = {key: tensor for key, tensor in tensors.items() if key != name}
    assert name in refusal(saved(tmp_path / "missing.pth", kept))


@pytest.mark.parametrize("name", ["register_tokens", "blocks.0.attn.extra.weight", "head.weight"])
def test_an_unexpected_tensor_is_named(tensors: Tensors, tmp_path: Path, name: str) -> None:
    assert name in refusal(saved(tmp_path / "more.pth", {**tensors, name: torch.zeros(1, 4, 128)}))


def test_a_tensor_of_another_shape_is_named(tensors: Tensors, tmp_path: Path) -> None:
    wrong = {**tensors, "blocks.0.mlp.fc2.bias": torch.zeros(129)}
    assert "blocks.0.mlp.fc2.bias" in refusal(saved(tmp_path / "wrong.pth", wrong))


def test_a_file_of_another_family_is_refused(tensors: Tensors, tmp_path: Path) -> None:
    prefixed = {f"backbone.model.{name}": tensor for name, tensor in tensors.items()}
    assert "patch_embed.proj.weight" in refusal(saved(tmp_path / "salad.ckpt", prefixed))


def test_the_blank_network_has_the_published_number_of_values_but_for_the_mask_token(file: Path) -> None:
    assert sum(values.numel() for values in method(file).blank().parameters()) == 86_580_480 - 768


@pytest.mark.parametrize(("backbone", "n"), [("vits14", 384), ("vitb14", 768), ("vitl14", 1024), ("vitg14", 1536)])
def test_the_blank_network_gives_as_many_numbers_as_the_published_one(file: Path, backbone: Any, n: int) -> None:
    blank = method(file, backbone=backbone).blank()
    assert blank(torch.zeros(2, 3, 42, 56, device="meta")).shape == (2, n)


# The contract and the yaml


def test_it_keeps_the_rules_of_the_contract(file: Path) -> None:
    weights = {"file": file.name, "licence": "none", "trained_on": "nothing", "path": str(file)}
    config = {"_target_": "vprbench.methods.dinov2.DINOv2", "weights": weights, "height": 42, "width": 56}
    assert [str(result) for result in conformance.check(config) if result.state == "broken"] == []


@pytest.mark.parametrize("backbone", ["vits14", "vitb14", "vitl14", "vitg14"])
def test_the_published_file_follows_from_the_backbone(backbone: str) -> None:
    weights = composed("method=dinov2", f"method.backbone={backbone}")["weights"]
    assert weights["file"] == f"dinov2_{backbone}_pretrain.pth"
    assert weights["url"] == (f"https://dl.fbaipublicfiles.com/dinov2/dinov2_{backbone}/dinov2_{backbone}_pretrain.pth")


def test_the_yaml_holds_the_arguments_and_defaults_of_the_class(file: Path) -> None:
    config = composed("method=dinov2")
    made = registry.make_method(config)
    own = {field.name for field in fields(DINOv2) if field.init}
    assert set(registry.entries("method")["dinov2"].options) == own
    default = DINOv2(weights=made.weights)  # type: ignore[attr-defined]
    assert {name: getattr(made, name) for name in own} == {name: getattr(default, name) for name in own}
