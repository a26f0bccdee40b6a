"""SALAD: equal to a slow computation from the tensors of a file by their published names."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch
from backbones_oracle import Tensors, imagenet, salad, salad_checkpoint, vit_checkpoint, vit_tokens
from described_images import composed, distance, encoded, image
from PIL import Image as PillowImage

from vprbench.api.weights import Weights
from vprbench.errors import BadInput
from vprbench.methods.salad import SALAD
from vprbench.plugins import conformance, registry

TOLERANCE = 1e-5
N_CLUSTERS, CLUSTER_DIM, TOKEN_DIM = 7, 12, 10
TOKEN = slice(0, TOKEN_DIM)


@pytest.fixture(scope="module")
def tensors() -> dict[str, torch.Tensor]:
    return checkpoint()


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory, tensors: Tensors) -> Path:
    return saved(tmp_path_factory.mktemp("salad") / "dino_salad.ckpt", tensors)


def checkpoint(*sizes: int) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    dino = {**vit_checkpoint(generator), "mask_token": torch.randn(1, 128, generator=generator)}
    aggregator = salad_checkpoint(generator, 128, *(sizes or (N_CLUSTERS, CLUSTER_DIM, TOKEN_DIM)))
    return {f"backbone.model.{name}": tensor for name, tensor in dino.items()} | {
        f"aggregator.{name}": tensor for name, tensor in aggregator.items()
    }


def saved(path: Path, content: Any) -> Path:
    torch.save(dict(content), path)
    return path


def method(path: Path, **arguments: Any) -> SALAD:
    weights = Weights(file=path.name, licence="none", trained_on="nothing", path=str(path))
    return SALAD(weights=weights, **{"height": None, "width": None, **arguments})


def expected(tensors: Tensors, image: npt.NDArray[np.uint8], final_norm: bool = True) -> npt.NDArray[np.float64]:
    tokens = vit_tokens(tensors, "backbone.model.", imagenet(image), final_norm=final_norm)[0]
    return salad(tensors, "aggregator.", tokens).numpy()


# Values


def test_images_of_two_sizes_have_the_descriptors_of_the_slow_computation(file: Path, tensors: Tensors) -> None:
    images = [image(56, 98), image(42, 70, 1), image(42, 70, 2)]
    codes = encoded(method(file), *images)
    assert distance(codes, np.stack([expected(tensors, seen) for seen in images])) < TOLERANCE


def test_in_the_published_sizes_there_are_8448_numbers(tmp_path: Path) -> None:
    tensors = checkpoint(64, 128, 256)
    codes = encoded(method(saved(tmp_path / "large.ckpt", tensors)), image(126, 112))
    assert codes.shape == (1, 8448)
    assert distance(codes, expected(tensors, image(126, 112))) < TOLERANCE


def test_one_patch_more_than_clusters_is_enough(file: Path, tensors: Tensors) -> None:
    assert distance(encoded(method(file), image(28, 56)), expected(tensors, image(28, 56))) < TOLERANCE


def test_without_the_final_norm_these_values_would_be_others(tensors: Tensors) -> None:
    seen = image(56, 98)
    assert distance(expected(tensors, seen), expected(tensors, seen, final_norm=False)) > 100 * TOLERANCE


def test_the_token_and_each_cluster_weigh_the_same(file: Path) -> None:
    code = encoded(method(file), image(56, 98))[0]
    clusters = code[TOKEN_DIM:].reshape(CLUSTER_DIM, N_CLUSTERS)
    parts = [np.linalg.norm(code[TOKEN]), *np.linalg.norm(clusters, axis=0)]
    assert np.allclose(parts, (1 + N_CLUSTERS) ** -0.5, atol=1e-6)


def test_what_is_added_to_all_scores_of_a_cluster_changes_nothing_however_much(
    tensors: Tensors, file: Path, tmp_path: Path
) -> None:
    bias = tensors["aggregator.score.3.bias"].clone()
    bias[0], bias[1] = bias[0] + 300, bias[1] - 300  # exponentials of which float32 does not hold
    other = saved(tmp_path / "biased.ckpt", {**tensors, "aggregator.score.3.bias": bias})
    assert distance(encoded(method(other), image(56, 98)), encoded(method(file), image(56, 98))) < 10 * TOLERANCE


def test_half_the_precision_keeps_the_descriptor(file: Path) -> None:
    network, seen = method(file).load(file), imagenet(image(56, 98))
    exact = network(seen.float())
    half = network.to(torch.bfloat16)(seen.bfloat16())
    assert half.dtype == torch.float32
    assert torch.nn.functional.cosine_similarity(half, exact).min() > 0.995


def test_an_image_is_seen_at_the_nearest_multiples_of_14(file: Path, tensors: Tensors) -> None:
    seen = np.asarray(PillowImage.fromarray(image(50, 90)).resize((84, 56), PillowImage.Resampling.BILINEAR))
    assert distance(encoded(method(file), image(50, 90)), expected(tensors, seen)) < TOLERANCE


def test_by_default_images_are_seen_at_322_pixels(file: Path) -> None:
    weights = Weights(file=file.name, licence="none", trained_on="nothing", path=str(file))
    assert SALAD(weights=weights).target(480, 640) == (322, 322)


def test_an_image_with_no_more_patches_than_clusters_is_refused(file: Path) -> None:
    with pytest.raises(BadInput, match=r"7 patches .* 7 clusters .* method\.height and method\.width to 42 pixels"):
        encoded(method(file), image(14, 98))


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


def test_tensors_may_lie_under_state_dict(file: Path, tensors: Tensors, tmp_path: Path) -> None:
    nested = saved(tmp_path / "nested.ckpt", {"epoch": 3, "state_dict": dict(tensors)})
    assert np.array_equal(encoded(method(nested), image(42, 42)), encoded(method(file), image(42, 42)))


@pytest.mark.parametrize(
    "name",
    [
        "aggregator.dust_bin",
        "aggregator.score.0.weight",
        "aggregator.cluster_features.3.weight",
        "aggregator.token_features.2.bias",
        "backbone.model.norm.weight",
        "backbone.model.pos_embed",
    ],
)
def test_a_missing_tensor_is_named(tensors: Tensors, tmp_path: Path, name: str) -> None:
    kept = {key: tensor for key, tensor in tensors.items() if key != name}
    assert name.rpartition("model.")[2] in refusal(saved(tmp_path / "missing.ckpt", kept))


@pytest.mark.parametrize("name", ["aggregator.linear.weight", "backbone.model.register_tokens", "loss.weight"])
def test_an_unexpected_tensor_is_named(tensors: Tensors, tmp_path: Path, name: str) -> None:
    assert name in refusal(saved(tmp_path / "more.ckpt", {**tensors, name: torch.zeros(3, 3)}))


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        ("aggregator.score.3.bias", (N_CLUSTERS + 1,)),
        ("aggregator.cluster_features.0.weight", (32, 64, 1, 1)),
        ("aggregator.dust_bin", (1,)),
    ],
)
def test_a_tensor_of_another_shape_is_named(
    tensors: Tensors, tmp_path: Path, name: str, shape: tuple[int, ...]
) -> None:
    assert name in refusal(saved(tmp_path / "wrong.ckpt", {**tensors, name: torch.zeros(shape)}))


def test_a_file_of_dinov2_alone_is_refused(tensors: Tensors, tmp_path: Path) -> None:
    dino = {name.removeprefix("backbone.model."): tensor for name, tensor in tensors.items() if "backbone" in name}
    assert "aggregator.token_features.0.weight" in refusal(saved(tmp_path / "dinov2_vitb14_pretrain.pth", dino))


def test_a_file_of_megaloc_is_refused(tensors: Tensors, tmp_path: Path) -> None:
    other = {name.replace("aggregator.", "aggregator.agg."): tensor for name, tensor in tensors.items()}
    assert "aggregator.token_features.0.weight" in refusal(saved(tmp_path / "megaloc.pth", other))


def test_the_blank_network_gives_as_many_numbers_as_the_published_one(file: Path) -> None:
    assert method(file).blank()(torch.zeros(2, 3, 126, 126, device="meta")).shape == (2, 8448)


# The contract and the yaml


def test_it_keeps_the_rules_of_the_contract(file: Path) -> None:
    weights = {"file": file.name, "licence": "none", "trained_on": "nothing", "path": str(file)}
    config = {"_target_": "vprbench.methods.salad.SALAD", "weights": weights, "height": 42, "width": 56}
    assert [str(result) for result in conformance.check(config) if result.state == "broken"] == []


@pytest.mark.parametrize(
    ("name", "file", "url"),
    [
        ("salad", "dino_salad.ckpt", "https://github.com/serizba/salad/releases/download/v1.0.0/dino_salad.ckpt"),
        ("cliquemining", "cliquemining.ckpt", "https://drive.google.com/uc?id=1B06ysb-Wjb4KDcNrl-7pyj1mJve1jqdk"),
    ],
)
def test_the_yaml_names_the_published_file(name: str, file: str, url: str) -> None:
    weights = composed(f"method={name}")["weights"]
    assert (weights["file"], weights["url"]) == (file, url)


@pytest.mark.parametrize("name", ["salad", "cliquemining"])
def test_the_yaml_holds_the_arguments_and_defaults_of_the_class(name: str) -> None:
    made = registry.make_method(composed(f"method={name}"))
    own = {field.name for field in fields(SALAD) if field.init}
    assert set(registry.entries("method")[name].options) == own
    default = SALAD(weights=made.weights)  # type: ignore[attr-defined]
    assert {option: getattr(made, option) for option in own} == {option: getattr(default, option) for option in own}
