"""GCL against float64 versions written from the key names of its checkpoints, and its whitening against an SVD."""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path

import backbones_oracle as oracle
import numpy as np
import pytest
import torch
from described_images import composed, distance, drawn_images, encoded, pillow
from published_networks import PublishedNetwork, saved, unit, with_checks

from vprbench.api.arrays import Image
from vprbench.errors import BadInput, NotFittedError
from vprbench.methods.gcl import Whitening
from vprbench.plugins import registry

SIZE = {"height": 64, "width": 96}


def drawn(kind: str, pooling: str = "GeM") -> oracle.Tensors:
    draw = oracle.Draw(len(kind))
    if kind == "vgg16":
        tensors = oracle.vgg16_checkpoint(draw, "backbone.")
    else:
        tensors = oracle.resnet_checkpoint(draw, kind, "backbone.")
    return tensors | ({"pool.p": torch.tensor([2.4])} if pooling == "GeM" else {})


def written(path: Path, tensors: oracle.Tensors, key: str = "model_state_dict", prefix: str = "") -> Path:
    """Write what the authors' training writes."""
    named = oracle.prefixed(prefix, tensors)
    optimizer = {"state": {}, "param_groups": [{"lr": 0.1, "momentum": 0, "params": [0, 1]}]}
    return saved(path, {key: named, "step": 1300, "optimizer": optimizer} if key else named)


def expected(
    tensors: oracle.Tensors,
    image: Image,
    kind: str = "vgg16",
    pooling: str = "GeM",
    resized=lambda image: pillow(image, 64, 96),
) -> torch.Tensor:
    x = oracle.imagenet(resized(image))
    x = oracle.vgg16(tensors, "backbone.", x) if kind == "vgg16" else oracle.resnet(tensors, "backbone.", x, kind)
    if pooling == "GeM":
        return oracle.gem(x, tensors["pool.p"])[0]
    return (x.mean((2, 3)) if pooling == "avg" else x.amax((2, 3)))[0]


NETWORK = PublishedNetwork(
    "gcl",
    lambda: drawn("vgg16"),
    drawn_images((131, 187), (64, 96), (131, 187), (70, 51)),
    512,
    expected,
    written,
    arguments={**SIZE, "backbone": "vgg16"},
    tolerance=1e-4,
    wrong={"pool.p": None, "backbone.30.weight": (3, 3), "backbone.0.weight": (64, 3, 5, 5)},
    options={
        f"shorter side of {size}": (
            {"height": None, "width": None, "shorter_side": 48},
            drawn_images(size)[0],
            {"resized": partial(pillow, height=seen[0], width=seen[1])},
        )
        for size, seen in [((80, 121), (48, 72)), ((121, 80), (72, 48)), ((50, 50), (48, 48))]
    },
    refused=[
        ("method.shorter_side=48", {"shorter_side": 48, "height": None}, (64, 96)),
        ("method.shorter_side=48", {"shorter_side": 48, "width": None}, (64, 96)),
        ("1 pixel", {"height": None, "width": None, "shorter_side": 0}, (64, 96)),
        ("32 pixels", {"height": 31}, (64, 96)),
        *(("unexpected", other, (64, 96)) for other in ({"pooling": "avg"}, {"backbone": "resnet50"})),
    ],
)


@with_checks(NETWORK)
def test_it_is_the_published_network(check, folder: Path) -> None:
    check(folder)


@pytest.mark.parametrize(
    ("backbone", "kind", "pooling"),
    [
        ("resnet50", "resnet50", "GeM"),
        ("resnext", "resnext101_32x8d", "GeM"),
        ("vgg16", "vgg16", "avg"),
        ("vgg16", "vgg16", "max"),
    ],
)
def test_other_backbones_and_poolings_are_those_of_the_published_layout(
    backbone: str, kind: str, pooling: str, folder: Path
) -> None:
    tensors, seen = drawn(kind, pooling), NETWORK.images[0]
    method = NETWORK.method(written(folder / "other.pth", tensors), backbone=backbone, pooling=pooling)
    wanted = NETWORK.slowly(seen, tensors=tensors, kind=kind, pooling=pooling)
    assert distance(encoded(method, seen), wanted) < 1e-4
    if backbone == "resnet50":  # takes the smallest image
        method.height = method.width = None
        assert np.isfinite(encoded(method, *drawn_images((3, 5)))).all()


@pytest.mark.parametrize(("key", "prefix"), [("state_dict", ""), ("model_state_dict", "module."), ("", "module.")])
def test_other_nestings_and_a_prefix_are_read(key: str, prefix: str, folder: Path) -> None:
    path = written(folder / "nested.pth", NETWORK.tensors, key, prefix)
    assert distance(encoded(NETWORK.method(path), NETWORK.images[0]), NETWORK.codes(folder)[:1]) < 2e-6


# Whitening


def vectors(n: int, seed: int, n_dimensions: int = 40) -> np.ndarray:
    """Unit vectors as networks give them: about a mean, with few strong directions and many weak ones."""
    generator = np.random.default_rng(seed)
    basis = np.random.default_rng(0).normal(size=(n_dimensions, n_dimensions)) / np.arange(1, n_dimensions + 1)[:, None]
    return unit(3 + generator.normal(size=(n, n_dimensions)) @ basis).astype(np.float32)


def whitened_slowly(references: np.ndarray, vectors: np.ndarray, kept: slice) -> np.ndarray:
    """The authors' whitening from singular values, learnt exactly and applied to float16."""
    precise = references.astype(np.float64)
    mean = precise.mean(0)
    _, sizes, directions = np.linalg.svd(precise - mean, full_matrices=False)
    rounded = vectors.astype(np.float16).astype(np.float64)
    components = (rounded - mean) @ directions[kept].T / (sizes[kept] / np.sqrt(2 * len(references)))
    return components / (np.linalg.norm(components, axis=1, keepdims=True) + 1e-6)


def scores(references: np.ndarray, queries: np.ndarray, n_components: int | None) -> np.ndarray:
    method = NETWORK.method(Path("none"), n_components=n_components)
    return method.fit_descriptors(references, np.arange(len(references))).match(queries)


@pytest.mark.parametrize(
    ("n_references", "n_components"), [(90, None), (90, 10), (90, 30), (90, 40), (25, 10), (25, 24), (5000, 12)]
)
def test_whitened_scores_are_those_of_singular_values(n_references: int, n_components: int | None) -> None:
    references, queries = vectors(n_references, 1), vectors(7, 2)
    left, right = queries, references
    if n_components:
        left, right = (whitened_slowly(references, codes, slice(n_components)) for codes in (queries, references))
    np.testing.assert_allclose(scores(references, queries, n_components), left @ right.T, rtol=0, atol=1e-4)


def test_repeated_references_and_constant_dimensions_add_no_components() -> None:
    assert Whitening.learn(vectors(12, 1), 2048).projection.shape == (40, 11)
    references = np.tile(vectors(6, 1), (20, 1))
    references[:, :3] = 0
    assert Whitening.learn(references, 2048).projection.shape == (40, 5)


@pytest.mark.parametrize("index", ["exact", "hnsw", "sq8"])
def test_equal_references_give_scores_of_zero(index: str) -> None:
    method = NETWORK.method(Path("none"), n_components=8, index=index)
    method.fit_descriptors(np.tile(vectors(1, 1), (5, 1)), np.arange(5))
    np.testing.assert_array_equal(method.match(vectors(3, 2)), np.zeros((3, 5)))


def test_whitened_descriptors_have_unit_length_and_the_mean_has_none() -> None:
    whitening = Whitening.learn(vectors(300, 1), 20)
    np.testing.assert_allclose(np.linalg.norm(whitening(vectors(9, 2)), axis=1), 1, atol=1e-5)
    middle = Whitening(np.full(40, 0.125, np.float32), whitening.projection)
    np.testing.assert_array_equal(middle(np.full((1, 40), 0.125, np.float32)), np.zeros((1, 20)))


def test_whitening_is_learnt_anew_and_from_references_alone() -> None:
    method = NETWORK.method(Path("none"), n_components=10)
    first, second, queries = vectors(60, 1), vectors(50, 2), vectors(7, 3)
    before = method.fit_descriptors(first, np.arange(60)).match(queries)
    method.match(first)
    np.testing.assert_array_equal(method.match(queries), before)
    method.fit_descriptors(second, np.arange(50))
    np.testing.assert_array_equal(method.match(queries), scores(second, queries, 10))


@pytest.mark.parametrize("index", ["exact", "hnsw", "sq8"])
def test_an_index_holds_whitened_references_and_is_audited_with_whitened_queries(index: str) -> None:
    references, queries = vectors(90, 1), vectors(7, 2)
    method = NETWORK.method(Path("none"), n_components=10, index=index)
    found = method.fit_descriptors(references, np.arange(90)).match(queries)
    retrieved = np.isfinite(found)
    np.testing.assert_allclose(found[retrieved], scores(references, queries, 10)[retrieved], rtol=0, atol=0.02)
    assert method.audit(queries).recall_at_1 == 1


def test_whitening_needs_a_map_and_a_component() -> None:
    with pytest.raises(NotFittedError):
        NETWORK.method(Path("none"), n_components=4).match(vectors(2, 1))
    with pytest.raises(BadInput, match=r"method.n_components=0"):
        scores(vectors(9, 1), vectors(2, 2), 0)


def test_a_missing_file_is_told_with_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VPRBENCH_WEIGHTS", str(tmp_path))
    with pytest.raises(BadInput, match=re.escape("python -m gdown --folder")) as error:
        registry.make_method(composed("method=gcl")).files()
    assert "\n" not in str(error.value)
