"""AP-GeM against a float64 version written from the key names of its file, whose PCA is a pickled object."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import backbones_oracle as oracle
import numpy as np
import pytest
import torch
from described_images import composed, distance, drawn_images, encoded
from sklearn.decomposition import PCA

from vprbench.api.weights import Weights
from vprbench.errors import BadInput
from vprbench.methods.ap_gem import APGeM
from vprbench.plugins import conformance

TOLERANCE = 1e-4
DIMENSIONS = 12


class Checkpoint:
    """What the published file holds, written as torch and numpy wrote it in 2019."""

    def __init__(self, kind: str = "resnet101", n_features: int = 2048) -> None:
        self.kind = kind
        generator = torch.Generator().manual_seed(6)
        self.tensors = oracle.resnet_checkpoint(generator, kind, numbered=False) | {
            "adpool.p": torch.tensor([2.6]),
            "fc.weight": torch.randn(DIMENSIONS, n_features, generator=generator) / 45,
            "fc.bias": 0.3 * torch.randn(DIMENSIONS, generator=generator),
        }
        drawn = np.random.default_rng(0).normal(size=(40, DIMENSIONS)) * np.geomspace(1, 0.05, DIMENSIONS) + 0.1
        self.pca = PCA(whiten=True).fit(drawn)

    def write(self, path: Path, module: ModuleType, **changes: Any) -> Path:
        """Write the file, whose PCA then belongs to `module`."""
        old = type("PCA", (), {"__module__": module.__name__})
        module.PCA = old
        pca = old()
        pca.__dict__.update(self.pca.__getstate__())
        content = {
            "current_iter": 296,
            "model_options": {"arch": "resnet101_rmac", "out_dim": DIMENSIONS, "pooling": "gem", "gemp": 3},
            "state_dict": {f"module.{name}": tensor for name, tensor in self.tensors.items()},
            "pca": {"Landmarks_clean": pca},
        }
        torch.save(content | changes, path, _use_new_zipfile_serialization=False)
        path.write_bytes(path.read_bytes().replace(b"cnumpy._core.multiarray\n", b"cnumpy.core.multiarray\n"))
        return path


@pytest.fixture(scope="module")
def module() -> Any:
    """scikit-learn's module of 2019, which is there while the file is written alone."""
    made = ModuleType("sklearn.decomposition.pca")
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, made.__name__, made)
        yield made


@pytest.fixture(scope="module")
def checkpoint() -> Checkpoint:
    return Checkpoint()


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> Checkpoint:
    """The same with a smaller backbone, where it is not the backbone that matters."""
    monkeypatch.setattr("vprbench.methods.ap_gem._BACKBONE", "resnet18")
    return Checkpoint("resnet18", 512)


@pytest.fixture(scope="module")
def file(folder: Path, checkpoint: Checkpoint, module: ModuleType) -> Path:
    return checkpoint.write(folder / "Resnet-101-AP-GeM.pt", module)


@pytest.fixture(scope="module")
def images() -> list[np.ndarray]:
    return drawn_images((64, 96), (71, 53))


def features(checkpoint: Checkpoint, images: Sequence[np.ndarray]) -> list[torch.Tensor]:
    """What the backbone makes of each image."""
    return [oracle.resnet(checkpoint.tensors, "", oracle.imagenet(x), checkpoint.kind, numbered=False) for x in images]


def method(path: Path, **arguments: Any) -> APGeM:
    return APGeM(weights=Weights("x", "", "", path=str(path)), **arguments)


def expected(
    checkpoint: Checkpoint,
    maps_of_images: Sequence[torch.Tensor],
    *,
    p: float | None = None,
    power: float = 0.25,
    unit_features: bool = False,
    unit_before: bool = True,
) -> np.ndarray:
    """Descriptors in float64; the options step into traps."""
    t = {name: tensor.double() for name, tensor in checkpoint.tensors.items()}
    p = t["adpool.p"].item() if p is None else p
    descriptors = []
    for maps in maps_of_images:
        pooled = maps[0].clamp(min=1e-6).pow(p).mean((1, 2)).pow(1 / p)
        pooled = pooled / pooled.norm() if unit_features else pooled
        vector = t["fc.weight"] @ pooled + t["fc.bias"]
        vector = (vector / vector.norm() if unit_before else vector).numpy()
        whitened = (vector - checkpoint.pca.mean_) @ checkpoint.pca.components_.T
        whitened /= checkpoint.pca.explained_variance_**power
        descriptors.append(whitened / np.linalg.norm(whitened))
    return np.array(descriptors)


def test_descriptors_are_those_of_the_published_layout(file: Path, checkpoint, images) -> None:
    codes, maps = encoded(method(file), *images), features(checkpoint, images)
    assert codes.shape == (2, DIMENSIONS)
    assert distance(codes, expected(checkpoint, maps)) < TOLERANCE
    for trap in ({"p": 3.0}, {"power": 0.5}, {"unit_before": False}):
        assert distance(codes, expected(checkpoint, maps, **trap)) > 20 * TOLERANCE


def test_pooled_features_get_unit_length_where_the_file_says_so(
    folder: Path, small: Checkpoint, module: ModuleType, images
) -> None:
    path = small.write(folder / "unit.pt", module, model_options={"norm_features": True})
    wanted = expected(small, features(small, images), unit_features=True)
    assert distance(encoded(method(path), *images), wanted) < TOLERANCE


def test_the_pickled_pca_runs_no_code_of_its_own(file: Path, module: ModuleType, monkeypatch) -> None:
    monkeypatch.setattr(module.PCA, "__setstate__", lambda *_: pytest.fail("code of the file ran"), raising=False)
    method(file).load(file)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"pca": {}}, "holds no pca of Landmarks_clean"),
        ({"pca": {"Landmarks_clean": torch.zeros(3)}}, "holds no pca of Landmarks_clean"),
        ({"state_dict": {"fc.bias": torch.zeros(DIMENSIONS)}}, r"missing \(conv1.weight"),
        ({"argument": np.random.RandomState}, "holds more than tensors"),
    ],
)
def test_another_file_is_refused(changes, told: str, folder: Path, small: Checkpoint, module: ModuleType) -> None:
    path = small.write(folder / "other.pt", module, **changes)
    with pytest.raises(BadInput, match=told):
        method(path).load(path)


def test_every_rule_of_the_contract_is_kept(
    folder: Path, small: Checkpoint, module: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = small.write(folder / "small.pt", module)
    network = method(file).load(file)
    monkeypatch.setattr(APGeM, "load", lambda *_: network)  # read once, for the suite makes many methods
    config = composed("method=ap_gem", "method.height=32", "method.width=32")
    config["weights"]["path"] = str(file)
    assert [str(result) for result in conformance.check(config) if result.state == "broken"] == []
