"""SuperVLAD, with and without its cross-image encoder, against a slow computation from the tensors of a file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from backbones_oracle import Tensors, imagenet, vit_checkpoint, vit_tokens
from cross_image_oracle import encoded_together, encoder_checkpoint
from described_images import composed, distance, encoded, image

from vprbench.api.weights import Weights
from vprbench.errors import BadInput
from vprbench.methods.supervlad import SuperVLAD, SuperVLADCrossImage
from vprbench.plugins import conformance, registry

TOLERANCE = 1e-5
DIM, CLUSTERS = 128, 4
KINDS = {"supervlad": SuperVLAD, "supervlad_crossimage": SuperVLADCrossImage}
IMAGES = [image(56, 98, seed) for seed in range(5)]


def drawn() -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(5)
    dino = vit_checkpoint(generator, DIM) | {"mask_token": torch.randn(1, DIM, generator=generator)}
    tensors = {f"module.backbone.{name}": tensor for name, tensor in dino.items()}
    weight = 6 * torch.randn(CLUSTERS + 1, DIM, 1, 1, generator=generator)
    encoder = encoder_checkpoint(generator, DIM, 48)
    return tensors | {"module.aggregation.conv.weight": weight} | {f"module.{k}": v for k, v in encoder.items()}


def saved(path: Path, tensors: Tensors) -> Path:
    """Write a checkpoint of a training, which keeps recalls as numpy has them."""
    torch.save({"model_state_dict": dict(tensors), "recalls": np.ones(4), "best_r5": np.float64(97.5)}, path)
    return path


@pytest.fixture(scope="module")
def tensors() -> dict[str, torch.Tensor]:
    return drawn()


@pytest.fixture(scope="module")
def files(folder: Path, tensors: Tensors) -> dict[str, Path]:
    plain = {name: tensor for name, tensor in tensors.items() if ".encoder." not in name}
    return {
        "supervlad": saved(folder / "SuperVLAD.pth", plain),
        "supervlad_crossimage": saved(folder / "SuperVLAD_crossimage.pth", tensors),
    }


def method(files: dict[str, Path], name: str, **arguments: Any) -> SuperVLAD | SuperVLADCrossImage:
    path = str(files[name])
    return KINDS[name](weights=Weights("x", "", "", path=path), **{"height": None, "width": None, **arguments})


def clusters(
    tensors: Tensors, image: np.ndarray, *, ghost: int = CLUSTERS, unit: bool = True, normed: bool = True
) -> torch.Tensor:
    """The clusters of one image as a vector of unit length, (CLUSTERS, DIM); the options step into traps."""
    t = {name.removeprefix("module."): value.double() for name, value in tensors.items()}
    patches = vit_tokens(t, "backbone.", imagenet(image), final_norm=normed)[0, 1:]
    patches = patches / patches.norm(dim=1, keepdim=True) if unit else patches
    shares = torch.softmax(patches @ t["aggregation.conv.weight"].flatten(1).T, dim=1)
    sums = []
    for cluster in (number for number in range(CLUSTERS + 1) if number != ghost):
        gathered = (shares[:, cluster, None] * patches).sum(0)
        sums.append(gathered / gathered.norm())
    return torch.stack(sums) / len(sums) ** 0.5


def together(tensors: Tensors, images: Sequence[np.ndarray]) -> np.ndarray:
    """Descriptors of images that see one another, (n, CLUSTERS * DIM)."""
    t = {name.removeprefix("module."): value for name, value in tensors.items()}
    vectors = encoded_together(t, torch.stack([clusters(tensors, seen) for seen in images])).flatten(1)
    return (vectors / vectors.norm(dim=1, keepdim=True)).numpy()


def test_images_of_two_sizes_have_the_descriptors_of_the_slow_computation(files, tensors: Tensors) -> None:
    images = [*IMAGES[:2], image(42, 70)]
    codes = encoded(method(files, "supervlad"), *images)
    assert codes.shape == (3, CLUSTERS * DIM)
    assert distance(codes, np.stack([clusters(tensors, seen).flatten().numpy() for seen in images])) < TOLERANCE


@pytest.mark.parametrize("trap", [{"ghost": 0}, {"unit": False}, {"normed": False}])
def test_each_trap_gives_other_descriptors(tensors: Tensors, trap: dict[str, Any]) -> None:
    wrong, right = clusters(tensors, IMAGES[0], **trap), clusters(tensors, IMAGES[0])
    assert distance(wrong.numpy(), right.numpy()) > 100 * TOLERANCE


@pytest.mark.parametrize("n", [1, 2])
def test_the_encoder_joins_as_many_images_as_asked(files, tensors: Tensors, n: int) -> None:
    codes = encoded(method(files, "supervlad_crossimage", images_together=n, batch_size=3), *IMAGES)
    groups = [IMAGES[first : first + n] for first in range(0, 5, n)]
    assert distance(codes, np.concatenate([together(tensors, group) for group in groups])) < TOLERANCE
    assert distance(together(tensors, IMAGES[:1]), together(tensors, IMAGES[:2])[:1]) > 100 * TOLERANCE


@pytest.mark.parametrize(
    ("name", "other", "told"),
    [
        ("supervlad", "supervlad_crossimage", r"24 unexpected \(encoder.layers.0"),
        ("supervlad_crossimage", "supervlad", r"holds no encoder.layers.0.linear1.weight"),
    ],
)
def test_the_file_of_the_other_is_refused(files, name: str, other: str, told: str) -> None:
    with pytest.raises(BadInput, match=told):
        method(files, name).load(files[other])


@pytest.mark.parametrize("name", KINDS)
def test_the_blank_network_gives_as_many_numbers_as_the_published_one(files, name: str) -> None:
    assert method(files, name).blank()(torch.zeros(2, 3, 56, 56, device="meta")).shape == (2, 3072)


# The contract and the yaml


@pytest.mark.parametrize(
    ("name", "n"), [("supervlad", None), ("supervlad_crossimage", 1), ("supervlad_crossimage", 16)]
)
def test_every_rule_of_the_contract_is_kept_or_excepted(
    files, name: str, n: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    network = method(files, name, **({} if n is None else {"images_together": n})).load(files[name])
    monkeypatch.setattr(KINDS[name], "load", lambda *_: network)  # read once, for the suite makes many methods
    overrides = [] if n is None else [f"method.images_together={n}"]
    config = composed(f"method={name}", "method.height=28", "method.width=42", *overrides)
    config["weights"]["path"] = str(files[name])
    results = [*conformance.check(config)]
    assert [str(result) for result in results if result.state == "broken"] == []
    assert len([result for result in results if "see one another" in result.reason]) == (2 if n == 16 else 0)


@pytest.mark.parametrize(
    ("name", "identifier"),
    [
        ("supervlad", "1wRkUO4E8s5hNRNNIWcuA8RUvlGob3Tbf"),
        ("supervlad_crossimage", "1yomnWGTJko6nf3F2Ju6RWsLhP2EG82tL"),
    ],
)
def test_the_yaml_holds_the_arguments_and_defaults_of_the_class(name: str, identifier: str) -> None:
    made = registry.make_method(composed(f"method={name}"))
    own = {field.name for field in fields(KINDS[name]) if field.init}
    assert set(registry.entries("method")[name].options) == own
    default = KINDS[name](weights=made.weights)  # type: ignore[attr-defined]
    assert {option: getattr(made, option) for option in own} == {option: getattr(default, option) for option in own}
    assert default.weights.url == f"https://drive.google.com/uc?id={identifier}"
    assert (default.height, default.width, default.resize) == (322, 322, "tensor")
