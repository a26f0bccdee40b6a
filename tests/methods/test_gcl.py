"""GCL against float64 versions written from the key names of its checkpoints, and its whitening against an SVD."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import backbones_oracle as oracle
import cv2
import numpy as np
import pytest
import torch
from described_images import composed, distance, drawn_images, encoded, pillow
from published_networks import PublishedNetwork, with_checks
from torch.nn import functional

from vprbench.errors import BadInput, NotFittedError
from vprbench.methods.gcl import Whitening
from vprbench.plugins import registry

KINDS = {"resnet50": "resnet50", "resnet152": "resnet152", "resnext": "resnext101_32x8d"}
SIZE = {"height": 64, "width": 96}


def drawn(backbone: str, pooling: str = "GeM") -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(len(backbone))
    if backbone == "vgg16":
        tensors = oracle.vgg16_checkpoint(generator, "backbone.")
    else:
        tensors = oracle.resnet_checkpoint(generator, KINDS[backbone], "backbone.")
    return tensors | ({"pool.p": torch.tensor([2.4])} if pooling == "GeM" else {})


def written(path: Path, tensors: dict[str, torch.Tensor], key: str = "model_state_dict", prefix: str = "") -> Path:
    """Write what the authors' training writes."""
    named = {f"{prefix}{name}": tensor for name, tensor in tensors.items()}
    optimizer = {"state": {}, "param_groups": [{"lr": 0.1, "momentum": 0, "params": [0, 1]}]}
    torch.save({key: named, "step": 1300, "optimizer": optimizer} if key else named, path)
    return path


def expected(
    tensors: dict[str, torch.Tensor],
    images: Sequence[np.ndarray],
    backbone: str = "vgg16",
    pooling: str = "GeM",
    *,
    resized=lambda image: pillow(image, 64, 96),
    last: int = 30,
    unit_channels: bool = False,
    p: float | None = None,
) -> np.ndarray:
    """Descriptors in float64; the options after `resized` step into traps."""
    descriptors = []
    for image in images:
        x = oracle.imagenet(resized(image))
        if backbone == "vgg16":
            x = oracle.vgg16(tensors, "backbone.", x, last)
        else:
            x = oracle.resnet(tensors, "backbone.", x, KINDS[backbone])
        if unit_channels:
            x = functional.normalize(x, dim=1)
        if pooling == "GeM":
            power = tensors["pool.p"].double().item() if p is None else p
            y = x.clamp(min=1e-6).pow(power).mean((2, 3)).pow(1 / power)
        else:
            y = x.mean((2, 3)) if pooling == "avg" else x.amax((2, 3))
        descriptors.append(functional.normalize(y, dim=1)[0].numpy())
    return np.array(descriptors)


NETWORK = PublishedNetwork(
    "gcl",
    lambda: drawn("vgg16"),
    drawn_images((131, 187), (64, 96), (131, 187), (70, 51)),
    512,
    expected,
    written,
    arguments={**SIZE, "backbone": "vgg16"},
    tolerance=1e-4,
    traps=[
        {"last": 28},  # without the last ReLU and pool, as NetVLAD and CosPlace have VGG16
        {"last": 29},  # without the last pool
        {"unit_channels": True},  # as CosPlace has it
        {"p": 3.0},  # what the power starts from
        {"resized": lambda image: cv2.resize(image, (96, 64), interpolation=cv2.INTER_LINEAR)},  # not antialiased
        {"resized": lambda image: pillow(image[..., ::-1], 64, 96)},  # BGR
        {"resized": lambda image: image},  # at its own size
    ],
    missing=["backbone.28.bias", "pool.p"],
    unexpected=["backbone.30.weight"],
    misshapen={"backbone.0.weight": (64, 3, 5, 5), "pool.p": (512,)},
    options={
        f"shorter side of {size}": (
            {"height": None, "width": None, "shorter_side": 48},
            drawn_images(size),
            {"resized": partial(pillow, height=seen[0], width=seen[1])},
        )
        for size, seen in [((80, 121), (48, 72)), ((121, 80), (72, 48)), ((50, 50), (48, 48))]
    },
    refused=[
        ("method.shorter_side=48", {"shorter_side": 48}, (64, 96)),
        ("1 pixel", {"height": None, "width": None, "shorter_side": 0}, (64, 96)),
        ("32 pixels", {"height": 31}, (64, 96)),
        *(("unexpected", other, (64, 96)) for other in ({"pooling": "avg"}, {"backbone": "resnet50"})),
    ],
    contract={"backbone": "resnet50", "height": 16, "width": 16, "batch_size": 64},
    draw_for_contract=lambda: drawn("resnet50"),
)


@with_checks(NETWORK)
def test_it_is_the_published_network(check, folder: Path) -> None:
    check(folder)


def test_the_whitened_network_keeps_the_contract_but_for_batches(folder: Path) -> None:
    excepted = replace(NETWORK, name="gcl_whitened").check_contract(folder)
    assert excepted == {"a batch gives what its single images give"}


@pytest.mark.parametrize(
    ("backbone", "pooling"), [*((name, "GeM") for name in KINDS), ("vgg16", "avg"), ("vgg16", "max")]
)
def test_other_backbones_and_poolings_are_those_of_the_published_layout(
    backbone: str, pooling: str, folder: Path
) -> None:
    tensors, images = drawn(backbone, pooling), NETWORK.images[:1]
    path = written(folder / "other.pth", tensors)
    codes = encoded(NETWORK.method(path, backbone=backbone, pooling=pooling), *images)
    path.unlink()
    assert codes.shape == (1, 512 if backbone == "vgg16" else 2048)
    assert distance(codes, expected(tensors, images, backbone, pooling)) < 1e-4


@pytest.mark.parametrize(("key", "prefix"), [("state_dict", ""), ("model_state_dict", "module."), ("", "module.")])
def test_other_nestings_and_a_prefix_are_read(key: str, prefix: str, folder: Path) -> None:
    path = written(folder / "nested.pth", NETWORK.tensors, key, prefix)
    assert distance(encoded(NETWORK.method(path), NETWORK.images[0]), NETWORK.codes(folder)[:1]) < 2e-6


def test_a_resnet_takes_the_smallest_image(folder: Path) -> None:
    path = written(folder / "small.pth", drawn("resnet50"))
    method = NETWORK.method(path, backbone="resnet50", height=None, width=None)
    assert np.isfinite(encoded(method, *drawn_images((3, 5)))).all()


# Whitening


def unit(n: int, n_dimensions: int, seed: int) -> np.ndarray:
    """Unit vectors as networks give them: about a mean, with few strong directions and many weak ones."""
    generator = np.random.default_rng(seed)
    basis = np.random.default_rng(0).normal(size=(n_dimensions, n_dimensions)) / np.arange(1, n_dimensions + 1)[:, None]
    vectors = 3 + generator.normal(size=(n, n_dimensions)) @ basis
    return (vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float32)


def whitened_slowly(
    references: np.ndarray,
    vectors: np.ndarray,
    kept: slice,
    *,
    centred: bool = True,
    scaled: bool = True,
    rounded: str = "applied",
) -> np.ndarray:
    """The authors' whitening from singular values, learnt exactly and applied to float16; the options are traps."""
    precise = references.astype(np.float16 if rounded == "both" else np.float64).astype(np.float64)
    mean = precise.mean(0) if centred else 0
    _, sizes, directions = np.linalg.svd(precise - mean, full_matrices=False)
    vectors = (vectors if rounded == "none" else vectors.astype(np.float16)).astype(np.float64)
    components = (vectors - mean) @ directions[kept].T / (sizes[kept] / np.sqrt(2 * len(references)) if scaled else 1)
    return components / (np.linalg.norm(components, axis=1, keepdims=True) + 1e-6)


def scores(references: np.ndarray, queries: np.ndarray, n_components: int | None) -> np.ndarray:
    method = NETWORK.method(Path("none"), n_components=n_components)
    method.fit_descriptors(references, np.arange(len(references)))
    return method.match(queries)


@pytest.mark.parametrize(
    ("n_references", "n_components"), [(90, None), (90, 10), (90, 40), (25, 10), (25, 24), (5000, 12)]
)
def test_whitened_scores_are_those_of_singular_values(n_references: int, n_components: int | None) -> None:
    references, queries = unit(n_references, 40, 1), unit(7, 40, 2)
    kept = slice(n_components)
    left, right = (
        whitened_slowly(references, codes, kept) if n_components else codes for codes in (queries, references)
    )
    np.testing.assert_allclose(scores(references, queries, n_components), left @ right.T, rtol=0, atol=1e-4)


@pytest.mark.parametrize(
    "trap",
    [
        *({"centred": False}, {"scaled": False}, {"kept": slice(-30, None)}, {"kept": slice(29)}),
        *({"rounded": "both"}, {"rounded": "none"}),
    ],
)
def test_each_trap_of_whitening_gives_other_scores(trap: dict[str, Any]) -> None:
    references, queries = unit(90, 40, 1), unit(7, 40, 2)
    options = {"kept": slice(30), **trap}
    wrong = whitened_slowly(references, queries, **options) @ whitened_slowly(references, references, **options).T
    assert np.abs(scores(references, queries, 30) - wrong).max() > 3e-4


def test_repeated_references_and_constant_dimensions_add_no_components() -> None:
    assert Whitening.learn(unit(12, 40, 1), 2048).projection.shape == (40, 11)
    references = np.tile(unit(6, 40, 1), (20, 1))
    references[:, :3] = 0
    assert Whitening.learn(references, 2048).projection.shape == (40, 5)


@pytest.mark.parametrize("index", ["exact", "hnsw", "sq8"])
def test_equal_references_give_scores_of_zero(index: str) -> None:
    method = NETWORK.method(Path("none"), n_components=8, index=index)
    method.fit_descriptors(np.tile(unit(1, 40, 1), (5, 1)), np.arange(5))
    np.testing.assert_array_equal(method.match(unit(3, 40, 2)), np.zeros((3, 5)))


def test_whitened_descriptors_have_unit_length_and_the_mean_has_none() -> None:
    whitening = Whitening.learn(unit(300, 40, 1), 20)
    np.testing.assert_allclose(np.linalg.norm(whitening(unit(9, 40, 2)), axis=1), 1, atol=1e-5)
    middle = Whitening(np.full(40, 0.125, np.float32), whitening.projection)
    np.testing.assert_array_equal(middle(np.full((1, 40), 0.125, np.float32)), np.zeros((1, 20)))


def test_whitening_is_learnt_anew_and_from_references_alone() -> None:
    method = NETWORK.method(Path("none"), n_components=10)
    first, second, queries = unit(60, 40, 1), unit(50, 40, 2), unit(7, 40, 3)
    method.fit_descriptors(first, np.arange(60))
    before = method.match(queries)
    method.match(first)
    np.testing.assert_array_equal(method.match(queries), before)
    method.fit_descriptors(second, np.arange(50))
    np.testing.assert_array_equal(method.match(queries), scores(second, queries, 10))


@pytest.mark.parametrize("index", ["exact", "hnsw", "sq8"])
def test_an_index_holds_whitened_references_and_is_audited_with_whitened_queries(index: str) -> None:
    references, queries = unit(90, 40, 1), unit(7, 40, 2)
    method = NETWORK.method(Path("none"), n_components=10, index=index)
    method.fit_descriptors(references, np.arange(90))
    found = method.match(queries)
    retrieved = np.isfinite(found)
    np.testing.assert_allclose(found[retrieved], scores(references, queries, 10)[retrieved], rtol=0, atol=0.02)
    assert method.audit(queries).recall_at_1 == 1


def test_whitening_needs_a_map_and_a_component() -> None:
    with pytest.raises(NotFittedError):
        NETWORK.method(Path("none"), n_components=4).match(unit(2, 40, 1))
    with pytest.raises(BadInput, match=r"method.n_components=0"):
        scores(unit(9, 40, 1), unit(2, 40, 2), 0)


def test_a_missing_file_is_told_with_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VPRBENCH_WEIGHTS", str(tmp_path))
    with pytest.raises(BadInput, match=re.escape("python -m gdown --folder")) as error:
        registry.make_method(composed("method=gcl")).files()
    assert "\n" not in str(error.value)
    assert "pip install" not in str(error.value)  # what that would install is here already
