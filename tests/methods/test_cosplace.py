"""CosPlace and EigenPlaces against float64 versions written from the key names of their files."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import backbones_oracle as oracle
import numpy as np
import pytest
import torch
from described_images import composed, drawn_images
from PIL import Image as PillowImage
from torch.nn import functional

from vprbench.api.images import Images
from vprbench.api.weights import Weights
from vprbench.errors import BadInput
from vprbench.methods.cosplace import CosPlace, EigenPlaces
from vprbench.plugins import conformance, registry

MEAN, DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
CHANNELS = {"VGG16": 512, "ResNet18": 512, "ResNet50": 2048, "ResNet101": 2048, "ResNet152": 2048}


def drawn(backbone: str, n_dimensions: int = 64) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(len(backbone))
    n_channels = CHANNELS[backbone]
    if backbone == "VGG16":
        tensors = oracle.vgg16_checkpoint(generator, "backbone.")
    else:
        tensors = oracle.resnet_checkpoint(generator, backbone.lower(), "backbone.")
    return tensors | {
        "aggregation.1.p": torch.tensor([2.4]),
        # What comes out of the pooling is a few hundredths.
        "aggregation.3.weight": torch.randn(n_dimensions, n_channels, generator=generator),
        "aggregation.3.bias": 0.3 * torch.randn(n_dimensions, generator=generator),
    }


def written(path: Path, tensors: dict[str, torch.Tensor]) -> Path:
    torch.save(tensors, path)
    return path


def cosplace(path: Path, **arguments: Any) -> CosPlace:
    weights = Weights("x.pth", "", "", path=str(path))
    return CosPlace(weights=weights, **{"backbone": "VGG16", "n_dimensions": 64, **arguments})


def expected(
    tensors: dict[str, torch.Tensor],
    images: Sequence[np.ndarray],
    backbone: str = "VGG16",
    *,
    resized=lambda x: x,
    before=lambda image: image,
    last: int = 28,
    unit_channels: bool = True,
    p: float | None = None,
    biased: bool = True,
) -> np.ndarray:
    """Descriptors in float64; the options after `resized` step into traps."""
    descriptors = []
    for image in images:
        x = torch.from_numpy(before(image).astype(np.float64)).permute(2, 0, 1)[None] / 255
        x = resized((x - torch.tensor(MEAN).double()[:, None, None]) / torch.tensor(DEVIATION).double()[:, None, None])
        if backbone == "VGG16":
            x = oracle.vgg16(tensors, "backbone.", x, last)
        else:
            x = oracle.resnet(tensors, "backbone.", x, backbone.lower())
        if unit_channels:
            x = x / x.square().sum(1, keepdim=True).sqrt().clamp(min=1e-12)
        power = tensors["aggregation.1.p"].double().item() if p is None else p
        y = x.clamp(min=1e-6).pow(power).mean((2, 3)).pow(1 / power)
        y = y @ tensors["aggregation.3.weight"].double().T
        y = y + tensors["aggregation.3.bias"].double() if biased else y
        descriptors.append((y / y.norm())[0].numpy())
    return np.array(descriptors)


def to_48x80(antialias: bool):
    return lambda x: functional.interpolate(x, (48, 80), mode="bilinear", align_corners=False, antialias=antialias)


@pytest.fixture(scope="module")
def tensors() -> dict[str, torch.Tensor]:
    return drawn("VGG16")


@pytest.fixture(scope="module")
def published(folder: Path, tensors: dict[str, torch.Tensor]) -> Path:
    return written(folder / "VGG16_64_cosplace.pth", tensors)


@pytest.fixture(scope="module")
def images() -> list[np.ndarray]:
    return drawn_images((64, 96), (71, 53), (71, 53), (64, 96))


@pytest.fixture(scope="module")
def codes(published: Path, images: list[np.ndarray]) -> np.ndarray:
    return cosplace(published).encode(Images.from_arrays(images))


def test_descriptors_of_images_at_their_own_size_are_those_of_the_published_layout(codes, tensors, images) -> None:
    assert codes.shape == (4, 64)
    assert codes.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(codes, axis=1), 1, atol=1e-5)
    np.testing.assert_allclose(codes, expected(tensors, images), rtol=0, atol=1e-4)


@pytest.mark.parametrize(
    ("backbone", "n_dimensions"), [("ResNet18", 32), ("ResNet50", 2048), ("ResNet101", 128), ("ResNet152", 512)]
)
def test_descriptors_of_a_resnet_are_those_of_the_published_layout(
    backbone: str, n_dimensions: int, folder: Path, images
) -> None:
    tensors = drawn(backbone, n_dimensions)
    path = written(folder / f"{backbone}.pth", tensors)
    codes = cosplace(path, backbone=backbone, n_dimensions=n_dimensions).encode(Images.from_arrays(images[:1]))
    path.unlink()
    assert codes.shape == (1, n_dimensions)
    np.testing.assert_allclose(codes, expected(tensors, images[:1], backbone), rtol=0, atol=1e-4)


def test_images_are_resized_as_tensors_with_antialiasing_where_a_size_is_given(published: Path, tensors) -> None:
    images = drawn_images((131, 187), (48, 80))
    codes = cosplace(published, height=48, width=80).encode(Images.from_arrays(images))
    np.testing.assert_allclose(codes, expected(tensors, images, resized=to_48x80(True)), rtol=0, atol=1e-4)
    aliased = expected(tensors, images[:1], resized=to_48x80(False))
    assert np.abs(codes[:1] - aliased).max() > 1e-3
    rounded = expected(
        tensors,
        images[:1],
        before=lambda image: np.asarray(PillowImage.fromarray(image).resize((80, 48), PillowImage.Resampling.BILINEAR)),
    )
    assert np.abs(codes[:1] - rounded).max() > 3e-4


@pytest.mark.parametrize(
    "trap",
    [
        {"last": 30},  # with the last ReLU and pool, as GCL has VGG16
        {"last": 29},  # with the last ReLU
        {"unit_channels": False},  # as GCL has it
        {"p": 3.0},  # what the power starts from
        {"biased": False},
        {"before": lambda image: image[..., ::-1]},  # BGR
    ],
)
def test_each_trap_gives_other_descriptors(trap: dict[str, Any], codes, tensors, images) -> None:
    assert np.abs(codes[:1] - expected(tensors, images[:1], **trap)).max() > 1e-3


def test_images_one_by_one_and_again_give_the_same(published: Path, codes, images) -> None:
    method = cosplace(published, batch_size=3)
    singles = np.concatenate([method.encode(Images.from_arrays([image])) for image in images])
    np.testing.assert_allclose(singles, codes, rtol=0, atol=2e-6)
    np.testing.assert_array_equal(cosplace(published).encode(Images.from_arrays(images)), codes)


def test_black_images_have_finite_descriptors(published: Path) -> None:
    black = cosplace(published).encode(Images.from_arrays([np.zeros((32, 48, 3), np.uint8)]))
    assert np.isfinite(black).all()


def test_images_that_leave_vgg_nothing_to_pool_are_refused(published: Path) -> None:
    with pytest.raises(BadInput, match="needs 16 pixels a side"):
        cosplace(published).encode(Images.from_arrays(drawn_images((40, 15))))


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("backbone.28.bias", None, r"1 missing \(backbone.28.bias\)"),
        ("aggregation.3.weight", None, r"1 missing \(aggregation.3.weight\)"),
        ("aggregation.3.running", torch.zeros(1), r"1 unexpected \(aggregation.3.running\)"),
        ("aggregation.3.weight", torch.zeros(64, 2048), r"aggregation.3.weight real \(64, 2048\)"),
        ("aggregation.1.p", torch.zeros(512), r"aggregation.1.p real \(512,\), wanted real \(1,\)"),
    ],
)
def test_a_file_that_differs_in_one_tensor_is_refused(name: str, value, told: str, folder: Path, tensors) -> None:
    changed = {key: tensor for key, tensor in tensors.items() if key != name} | ({} if value is None else {name: value})
    path = written(folder / "changed.pth", changed)
    with pytest.raises(BadInput, match=told) as error:
        cosplace(path).load(path)
    assert "\n" not in str(error.value)


def test_a_file_of_other_dimensions_is_refused_with_the_argument_that_it_wants(published: Path) -> None:
    with pytest.raises(BadInput, match=r"64 dimensions: set method.n_dimensions=64, or give weights of 128"):
        cosplace(published, n_dimensions=128).load(published)


def test_a_file_of_another_method_is_refused(folder: Path) -> None:
    other = oracle.vgg16_checkpoint(torch.Generator(), "backbone.") | {"pool.p": torch.ones(1)}
    path = written(folder / "gcl.pth", other)
    with pytest.raises(BadInput, match=r"3 missing \(aggregation.1.p.*1 unexpected \(pool.p\)") as error:
        cosplace(path).load(path)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("backbone", CHANNELS)
def test_the_blank_network_has_the_published_tensors(backbone: str) -> None:
    with torch.device("meta"):
        blank = CosPlace(weights=Weights("", "", ""), backbone=backbone, n_dimensions=512).blank()
    published = {name: tensor.shape for name, tensor in drawn(backbone, 512).items()}
    assert {name: tensor.shape for name, tensor in blank.state_dict().items()} == published


# The yaml files and the contract


@pytest.mark.parametrize("name", ["cosplace", "eigenplaces"])
def test_the_options_are_the_arguments(name: str) -> None:
    arguments = {field.name for field in fields(CosPlace) if field.init}
    assert set(registry.entries("method")[name].options) == arguments


@pytest.mark.parametrize(
    ("name", "url"),
    [
        ("cosplace", "https://github.com/gmberton/CosPlace/releases/download/v1.0/ResNet50_2048_cosplace.pth"),
        ("eigenplaces", "https://github.com/gmberton/EigenPlaces/releases/download/v1.0/ResNet50_2048_eigenplaces.pth"),
    ],
)
def test_the_yaml_is_the_published_default(name: str, url: str) -> None:
    method = registry.make_method(composed(f"method={name}"))
    assert isinstance(method, EigenPlaces if name == "eigenplaces" else CosPlace)
    assert method.weights.url == url
    assert method.weights.file == url.rpartition("/")[2]
    assert (method.height, method.width, method.resize, method.interpolation) == (None, None, "tensor", "bilinear")


def test_file_and_url_follow_the_arguments() -> None:
    weights = composed("method=cosplace", "method.backbone=VGG16", "method.n_dimensions=128")["weights"]
    assert weights["file"] == "VGG16_128_cosplace.pth"
    assert weights["url"].endswith("/v1.0/VGG16_128_cosplace.pth")


@pytest.mark.parametrize(
    ("kind", "backbone", "published"),
    [
        (CosPlace, "VGG16", {64, 128, 256, 512}),
        (CosPlace, "ResNet18", {32, 64, 128, 256, 512}),
        *((CosPlace, name, {32, 64, 128, 256, 512, 1024, 2048}) for name in ("ResNet50", "ResNet101", "ResNet152")),
        (EigenPlaces, "VGG16", {512}),
        (EigenPlaces, "ResNet18", {256, 512}),
        *((EigenPlaces, name, {128, 256, 512, 1024, 2048}) for name in ("ResNet50", "ResNet101")),
        (EigenPlaces, "ResNet152", set()),
    ],
)
def test_only_what_was_published_is_looked_for(
    kind, backbone: str, published: set[int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("VPRBENCH_WEIGHTS", str(tmp_path))
    (tmp_path / "there.pth").touch()
    found = set()
    for n_dimensions in (16, 32, 64, 128, 256, 512, 1024, 2048, 4096):
        method = kind(weights=Weights("there.pth", "", ""), backbone=backbone, n_dimensions=n_dimensions)
        with contextlib.suppress(BadInput):
            assert method.files() == (tmp_path / "there.pth",)
            found.add(n_dimensions)
    assert found == published


def test_what_was_not_published_is_told_with_what_was() -> None:
    with pytest.raises(BadInput, match=r"n_dimensions=64: EigenPlaces was published with VGG16 512; ResNet18 256, 512"):
        EigenPlaces(weights=Weights("x.pth", "", ""), backbone="VGG16", n_dimensions=64).files()


@pytest.mark.parametrize("name", ["cosplace", "eigenplaces"])
def test_every_rule_of_the_contract_is_kept(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(folder / "contract.pth", drawn("ResNet18"))
    network = cosplace(path, backbone="ResNet18").load(path)
    monkeypatch.setattr(CosPlace, "load", lambda *_: network)  # read once, for the suite makes many methods
    config = composed(f"method={name}", "method.backbone=ResNet18", "method.n_dimensions=64")
    config |= {"height": 24, "width": 32}
    config["weights"]["path"] = str(path)
    broken = [str(result) for result in conformance.check(config) if result.state == "broken"]
    assert broken == []
