"""MegaLoc: equal to a slow computation from the tensors of a file by their published names."""

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
from safetensors.torch import save_file
from torch.nn import functional

from vprbench.api.weights import Weights
from vprbench.errors import BadInput
from vprbench.methods.megaloc import MegaLoc
from vprbench.plugins import conformance, registry

TOLERANCE = 1e-5
N_CLUSTERS, CLUSTER_DIM, TOKEN_DIM, N_DIMENSIONS = 7, 12, 10, 40


@pytest.fixture(scope="module")
def tensors() -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(3)
    dino = vit_checkpoint(generator)
    aggregator = salad_checkpoint(generator, 128, N_CLUSTERS, CLUSTER_DIM, TOKEN_DIM)
    n_inner = N_CLUSTERS * CLUSTER_DIM + TOKEN_DIM
    return {
        **{f"backbone.{name}": tensor for name, tensor in dino.items()},
        **{f"aggregator.agg.{name}": tensor for name, tensor in aggregator.items()},
        "aggregator.linear.weight": torch.randn(N_DIMENSIONS, n_inner, generator=generator),
        "aggregator.linear.bias": 0.5 * torch.randn(N_DIMENSIONS, generator=generator),
    }


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory, tensors: Tensors) -> Path:
    return saved(tmp_path_factory.mktemp("megaloc") / "MegaLoc.safetensors", tensors)


def saved(path: Path, tensors: Tensors) -> Path:
    save_file({name: tensor.contiguous() for name, tensor in tensors.items()}, path)
    return path


def method(path: Path, **arguments: Any) -> MegaLoc:
    weights = Weights(file=path.name, licence="none", trained_on="nothing", path=str(path))
    return MegaLoc(weights=weights, **arguments)


def expected(tensors: Tensors, seen: torch.Tensor, final_norm: bool = True, unit: bool = True) -> npt.NDArray[Any]:
    tokens = vit_tokens(tensors, "backbone.", seen, final_norm=final_norm)[0]
    inner = salad(tensors, "aggregator.agg.", tokens) * (1 if unit else 7)
    weight, bias = (tensors[f"aggregator.linear.{part}"].double() for part in ("weight", "bias"))
    vector = weight @ inner + bias
    return (vector / vector.norm()).numpy()


# Values


def test_images_of_two_sizes_have_the_descriptors_of_the_slow_computation(file: Path, tensors: Tensors) -> None:
    images = [image(56, 98), image(42, 70, 1), image(42, 70, 2)]
    codes = encoded(method(file), *images)
    assert codes.shape == (3, N_DIMENSIONS)
    assert distance(codes, np.stack([expected(tensors, imagenet(seen)) for seen in images])) < TOLERANCE


@pytest.mark.parametrize("how", [{"final_norm": False}, {"unit": False}], ids=["no final norm", "no inner length"])
def test_another_way_would_give_other_values(tensors: Tensors, how: dict[str, bool]) -> None:
    seen = imagenet(image(56, 98))
    assert distance(expected(tensors, seen), expected(tensors, seen, **how)) > 100 * TOLERANCE


@pytest.mark.parametrize(("height", "width", "rows", "columns"), [(50, 90, 4, 6), (64, 96, 5, 7), (41, 43, 3, 3)])
def test_an_image_is_seen_at_the_nearest_multiples_of_14_as_antialiased_floats(
    file: Path, tensors: Tensors, height: int, width: int, rows: int, columns: int
) -> None:
    given = image(height, width)
    seen = functional.interpolate(
        imagenet(given), (14 * rows, 14 * columns), mode="bilinear", align_corners=False, antialias=True
    )
    assert distance(encoded(method(file), given), expected(tensors, seen)) < TOLERANCE


def test_half_the_precision_keeps_the_descriptor(file: Path) -> None:
    network, seen = method(file).load(file), imagenet(image(56, 98))
    exact = network(seen.float())
    half = network.to(torch.bfloat16)(seen.bfloat16()).float()
    assert functional.cosine_similarity(half, exact).min() > 0.99


def test_an_image_with_no_more_patches_than_clusters_is_refused(file: Path) -> None:
    with pytest.raises(BadInput, match=r"6 patches .* 7 clusters .* method\.height and method\.width to 42 pixels"):
        encoded(method(file), image(28, 42))


def test_descriptors_are_unit_vectors_that_neither_batch_nor_repetition_changes(file: Path) -> None:
    images = [image(48, 64, seed) for seed in range(3)]
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
    "name",
    [
        "aggregator.linear.weight",
        "aggregator.linear.bias",
        "aggregator.agg.dust_bin",
        "aggregator.agg.score.3.weight",
        "backbone.norm.weight",
        "backbone.blocks.0.ls1.gamma",
    ],
)
def test_a_missing_tensor_is_named(tensors: Tensors, tmp_path: Path, name: str) -> None:
    kept = {key: tensor for key, tensor in tensors.items() if key != name}
    assert name in refusal(saved(tmp_path / "missing.safetensors", kept))


@pytest.mark.parametrize("name", ["aggregator.score.0.weight", "backbone.model.cls_token"])
def test_an_unexpected_tensor_is_named(tensors: Tensors, tmp_path: Path, name: str) -> None:
    assert name in refusal(saved(tmp_path / "more.safetensors", {**tensors, name: torch.zeros(3, 3)}))


@pytest.mark.parametrize("name", ["aggregator.linear.weight", "aggregator.agg.token_features.2.bias"])
def test_a_tensor_of_another_shape_is_named(tensors: Tensors, tmp_path: Path, name: str) -> None:
    wrong = {**tensors, name: torch.zeros(3, 5)}
    assert name in refusal(saved(tmp_path / "wrong.safetensors", wrong))


def test_a_file_of_salad_is_refused(tensors: Tensors, tmp_path: Path) -> None:
    other = {
        name.replace("backbone.", "backbone.model.").replace("aggregator.agg.", "aggregator."): tensor
        for name, tensor in tensors.items()
        if "linear" not in name
    }
    assert "aggregator.agg.token_features.0.weight" in refusal(saved(tmp_path / "salad.safetensors", other))


def test_the_blank_network_has_the_published_number_of_values(file: Path) -> None:
    assert sum(values.numel() for values in method(file).blank().parameters()) / 1e6 == pytest.approx(228.6, abs=0.1)


def test_the_blank_network_gives_as_many_numbers_as_the_published_one(file: Path) -> None:
    assert method(file).blank()(torch.zeros(2, 3, 126, 126, device="meta")).shape == (2, 8448)


# The contract and the yaml


def test_it_keeps_the_rules_of_the_contract(file: Path) -> None:
    weights = {"file": file.name, "licence": "none", "trained_on": "nothing", "path": str(file)}
    config = {"_target_": "vprbench.methods.megaloc.MegaLoc", "weights": weights}
    assert [str(result) for result in conformance.check(config) if result.state == "broken"] == []


def test_the_yaml_names_the_published_file() -> None:
    weights = composed("method=megaloc")["weights"]
    assert weights["url"] == "https://huggingface.co/gberton/MegaLoc/resolve/main/model.safetensors"
    assert weights["file"] == "MegaLoc.safetensors"


def test_the_yaml_holds_the_arguments_and_defaults_of_the_class() -> None:
    made = registry.make_method(composed("method=megaloc"))
    own = {field.name for field in fields(MegaLoc) if field.init}
    assert set(registry.entries("method")["megaloc"].options) == own
    default = MegaLoc(weights=made.weights)  # type: ignore[attr-defined]
    assert {name: getattr(made, name) for name in own} == {name: getattr(default, name) for name in own}
