"""AP-GeM against a float64 version written from the key names of its file, whose PCA is a pickled object."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import backbones_oracle as oracle
import numpy as np
import pytest
import torch
from described_images import drawn_images, encoded
from published_networks import PublishedNetwork, with_checks
from sklearn.decomposition import PCA

from vprbench.api.arrays import Image
from vprbench.errors import BadInput

DIMENSIONS = 12
#: scikit-learn's module of 2019, which is there while a file is written alone.
MODULE = ModuleType("sklearn.decomposition.pca")
FITTED = PCA(whiten=True).fit(
    np.random.default_rng(0).normal(size=(40, DIMENSIONS)) * np.geomspace(1, 0.05, DIMENSIONS) + 0.1
)


def drawn(kind: str = "resnet101", n_features: int = 2048) -> oracle.Tensors:
    draw = oracle.Draw(6)
    tensors = oracle.resnet_checkpoint(draw, kind, numbered=False) | {"adpool.p": torch.tensor([2.6])}
    tensors["fc.weight"] = draw.normal(DIMENSIONS, n_features, scale=1 / 45)
    tensors["fc.bias"] = draw.normal(DIMENSIONS, scale=0.3)
    return oracle.prefixed("module.", tensors)


def written(path: Path, tensors: oracle.Tensors, **changes: Any) -> Path:
    """Write what the published file holds, as torch and numpy wrote it in 2019."""
    old = type("PCA", (), {"__module__": MODULE.__name__})
    MODULE.PCA = old
    pca = old()
    pca.__dict__.update(FITTED.__getstate__())
    content = {
        "model_options": {"arch": "resnet101_rmac", "out_dim": DIMENSIONS, "pooling": "gem", "gemp": 3},
        "state_dict": dict(tensors),
        "pca": {"Landmarks_clean": pca},
    }
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, MODULE.__name__, MODULE)
        torch.save(content | changes, path, _use_new_zipfile_serialization=False)
    path.write_bytes(path.read_bytes().replace(b"cnumpy._core.multiarray\n", b"cnumpy.core.multiarray\n"))
    return path


def expected(tensors: oracle.Tensors, image: Image, kind: str = "resnet101", unit_features: bool = False) -> np.ndarray:
    t = oracle.under(tensors, "module.")
    maps = oracle.resnet(t, "", oracle.imagenet(image), kind, numbered=False)
    pooled = oracle.gem(maps, t["adpool.p"])[0]
    pooled = pooled / pooled.norm() if unit_features else pooled
    vector = t["fc.weight"] @ pooled + t["fc.bias"]
    whitened = ((vector / vector.norm()).numpy() - FITTED.mean_) @ FITTED.components_.T
    return whitened / FITTED.explained_variance_**0.25


NETWORK = PublishedNetwork(
    "ap_gem",
    drawn,
    drawn_images((64, 96), (71, 53)),
    DIMENSIONS,
    expected,
    written,
    tolerance=1e-4,
    alike_in_half=0.95,
)


@with_checks(NETWORK)
def test_it_is_the_published_network(check, folder: Path) -> None:
    check(folder)


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> oracle.Tensors:
    """Tensors of a smaller backbone, where it is not the backbone that matters."""
    monkeypatch.setattr("vprbench.methods.ap_gem._BACKBONE", "resnet18")
    return drawn("resnet18", 512)


def test_pooled_features_get_unit_length_where_the_file_says_so(folder: Path, small: oracle.Tensors) -> None:
    path = written(folder / "unit.pt", small, model_options={"norm_features": True})
    seen = NETWORK.images[0]
    wanted = NETWORK.slowly(seen, tensors=small, kind="resnet18", unit_features=True)
    assert np.abs(encoded(NETWORK.method(path), seen) - wanted).max() < 1e-4


def test_the_pickled_pca_runs_no_code_of_its_own(folder: Path, small: oracle.Tensors, monkeypatch) -> None:
    path = written(folder / "code.pt", small)
    monkeypatch.setitem(sys.modules, MODULE.__name__, MODULE)
    monkeypatch.setattr(MODULE.PCA, "__setstate__", lambda *_: pytest.fail("code of the file ran"), raising=False)
    NETWORK.method(path).load(path)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"pca": {}}, "holds no pca of Landmarks_clean"),
        ({"pca": [1]}, "holds no pca of Landmarks_clean"),
        ({"pca": {"Landmarks_clean": torch.zeros(3)}}, "holds no pca of Landmarks_clean"),
        ({"pca": {"Landmarks_clean": {"mean_": np.zeros(DIMENSIONS)}}}, "holds no pca of Landmarks_clean"),
        ({"state_dict": {"fc.bias": torch.zeros(DIMENSIONS)}}, r"missing \(conv1.weight"),
        ({"argument": np.random.RandomState}, "holds more than tensors"),
    ],
)
def test_another_file_is_refused(changes, told: str, folder: Path, small: oracle.Tensors) -> None:
    path = written(folder / "other.pt", small, **changes)
    with pytest.raises(BadInput, match=told):
        NETWORK.method(path).load(path)
