"""NetVLAD in its three published layouts, against a float64 version written from the key names of the files."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import backbones_oracle as oracle
import numpy as np
import pytest
import scipy.io
import torch
from described_images import composed, distance, drawn_images, encoded, pillow
from published_networks import PublishedNetwork, with_checks
from torch import Tensor
from torch.nn import functional

from vprbench.methods.netvlad import NetVLAD

IMAGENET = np.array([[0.485, 0.456, 0.406], [0.229, 0.224, 0.225]])
AVERAGE = np.array([117.5, 120.25, 90.75])  # of the .mat; unlike the usual mean, so that only the file's will do
SIZES = [(64, 96), (49, 70), (64, 96)]

Tensors = dict[str, Tensor]


def drawn(clusters: int, components: int | None = None, seed: int = 0) -> Tensors:
    """Random tensors under the names of family C; without `components` those of family B."""
    generator = torch.Generator().manual_seed(seed)
    tensors = oracle.vgg16_checkpoint(generator, "encoder.")
    tensors["pool.centroids"] = torch.randn(clusters, 512, generator=generator) / 512**0.5
    tensors["pool.conv.weight"] = 4 * torch.randn(clusters, 512, 1, 1, generator=generator)
    if components is not None:
        shape = (components, clusters * 512, 1, 1)
        tensors["WPCA.0.weight"] = torch.randn(shape, generator=generator, dtype=torch.float64)
        tensors["WPCA.0.bias"] = 0.5 * torch.randn(components, generator=generator, dtype=torch.float64)
    return tensors


def cell(*values: Any) -> np.ndarray:
    """What savemat writes as a row of cells."""
    cells = np.empty((1, len(values)), dtype=object)
    for i, value in enumerate(values):
        cells[0, i] = value
    return cells


def layer(kind: str, *weights: np.ndarray) -> dict[str, Any]:
    return {"type": kind, "name": kind, "weights": cell(*weights)}


def write_struct(path: Path, tensors: Tensors, average: np.ndarray = AVERAGE) -> Path:
    """Write tensors, of which the whitening takes channels first, as MatConvNet keeps them."""
    layers = []
    for number in range(29):
        name = f"encoder.{number}"
        if f"{name}.weight" in tensors:
            weight = tensors[f"{name}.weight"].numpy().transpose(2, 3, 1, 0)
            layers.append(layer("conv", weight, tensors[f"{name}.bias"].numpy()[:, None]))
        else:
            layers.append(layer("pool" if number in oracle.VGG16_POOLS else "relu"))
    assignment = tensors["pool.conv.weight"].numpy()[:, :, 0, 0].T[None, None]
    minus_centres = -tensors["pool.centroids"].numpy().T[None, None]
    projection = tensors["WPCA.0.weight"].float().numpy()[:, :, 0, 0].T[None, None]
    bias = tensors["WPCA.0.bias"].float().numpy()[:, None]
    layers += [layer("normalize"), layer("custom", assignment, minus_centres), layer("custom"), layer("normalize")]
    layers += [layer("conv", projection, bias), layer("normalize")]
    images = np.broadcast_to(average, (5, 4, 3))
    meta = {"normalization": {"averageImage": images, "imageSize": [224, 224, 3]}, "sessionID": "x"}
    scipy.io.savemat(path, {"net": {"layers": cell(*layers), "meta": meta}})
    return path


def write_checkpoint(path: Path, tensors: Tensors, **extras: Any) -> Path:
    """Write what training with PyTorch writes: the tensors, and what else there is."""
    optimizer = {"state": {}, "param_groups": [{"lr": 0.1, "params": [0, 1]}]}
    torch.save({"epoch": 30, "state_dict": tensors, "optimizer": optimizer, "parallel": False, **extras}, path)
    return path


def expected(
    tensors: Tensors,
    images: Sequence[np.ndarray],
    family: str = "patch-netvlad",
    *,
    resized: Callable[[np.ndarray], np.ndarray] = lambda image: image,
    whiten: bool = True,
    keep: int | None = None,
    cluster_fastest: bool | None = None,  # these and what follows step into traps
    levels: bool | None = None,
    last: int = 28,
    sign: float = 1.0,
    unit_locals: bool = True,
    intra: bool = True,
) -> np.ndarray:
    """Descriptors in float64, residual by residual."""
    cluster_fastest = family == "matconvnet" if cluster_fastest is None else cluster_fastest
    levels = family == "matconvnet" if levels is None else levels
    descriptors = []
    for image in images:
        x = resized(image).astype(np.float64)
        x = x - AVERAGE if levels else (x / 255 - IMAGENET[0]) / IMAGENET[1]
        features = oracle.vgg16(tensors, "encoder.", torch.from_numpy(x).permute(2, 0, 1)[None], last)[0].flatten(1)
        local = (functional.normalize(features, dim=0) if unit_locals else features).T  # (n, channels)
        shares = torch.softmax(local @ tensors["pool.conv.weight"].double().flatten(1).T, dim=1)
        residuals = local[:, None] - sign * tensors["pool.centroids"].double()  # (n, clusters, channels)
        columns = (shares[:, :, None] * residuals).sum(0)
        columns = functional.normalize(columns, dim=1) if intra else columns
        vector = functional.normalize((columns.T if cluster_fastest else columns).flatten(), dim=0)
        if whiten and family != "pytorch":
            vector = tensors["WPCA.0.weight"].double().flatten(1) @ vector + tensors["WPCA.0.bias"].double()
            vector = functional.normalize(vector, dim=0)
        descriptors.append(functional.normalize(vector[:keep], dim=0).numpy())
    return np.stack(descriptors)


def of_levels(tensors: Tensors) -> Tensors:
    """The same network for inputs that are 0 to 255 and not divided by deviations."""
    scale = torch.tensor(255 * IMAGENET[1], dtype=torch.float32)[:, None, None]
    return tensors | {"encoder.0.weight": tensors["encoder.0.weight"] / scale}


TRAPS = ({"last": 29}, {"last": 30}, {"unit_locals": False}, {"intra": False})


def network(name: str, family: str, draw: Callable[[], Tensors], n_dimensions: int, **more: Any) -> PublishedNetwork:
    more["traps"] = [*more["traps"], *TRAPS]
    whiten = family != "pytorch"
    options = {"few dimensions": ({"n_dimensions": 3}, drawn_images((49, 70)), {"keep": 3}), **more.pop("options", {})}
    options |= {"unwhitened": ({"whiten": False}, drawn_images((64, 96)), {"whiten": False})}
    refused = [
        *((f"method.n_dimensions={wrong}", {"n_dimensions": wrong}, (49, 70)) for wrong in (0, n_dimensions + 1)),
        ("method.longest_side=0", {"longest_side": 0}, (32, 32)),
        ("16 pixels", {}, (15, 40)),
        *([] if whiten else [("method.whiten=true", {"whiten": True}, (32, 32))]),
    ]
    return PublishedNetwork(
        name,
        draw,
        drawn_images(*SIZES),
        n_dimensions,
        partial(expected, family=family),
        write_struct if family == "matconvnet" else write_checkpoint,
        arguments={"family": family, "whiten": whiten, "longest_side": None, "resize": "pillow"},
        tolerance=1e-4,
        batch_tolerance=1e-5,
        alike_in_half=0.98,
        trap_distance=2e-3,
        options=options,
        refused=refused,
        contract={"height": 16, "width": 32},
        **more,
    )


NETWORKS = {
    "matconvnet": network(
        "netvlad",
        "matconvnet",
        lambda: of_levels(drawn(64, 8, seed=1)),
        8,
        traps=[{"cluster_fastest": False}, {"levels": False}, {"sign": -1.0}],
        misshapen={"WPCA.0.weight": (8, 1024, 1, 1)},
        options={
            "unrounded means of a long image": (
                {"longest_side": 96, "resize": "area"},
                drawn_images((128, 192)),
                {"resized": lambda image: image.reshape(64, 2, 96, 2, 3).mean((1, 3))},
            )
        },
    ),
    "pytorch": network(
        "netvlad_pytorch",
        "pytorch",
        lambda: drawn(5, seed=2),
        5 * 512,
        traps=[{"cluster_fastest": True}, {"levels": True}],
        unexpected=["WPCA.0.bias"],
    ),
    "patch-netvlad": network(
        "netvlad_msls",
        "patch-netvlad",
        lambda: drawn(4, 6, seed=3),
        6,
        traps=[{"cluster_fastest": True}, {"levels": True}],
        missing=["encoder.28.bias", "pool.centroids", "WPCA.0.weight", "WPCA.0.bias"],
        unexpected=["pool.conv.bias"],
        misshapen={"encoder.5.bias": (63,)},
        options={
            "antialiased": (
                {"height": 48, "width": 64},
                drawn_images((150, 210)),
                {"resized": partial(pillow, height=48, width=64)},
            )
        },
    ),
}


@pytest.fixture
def netvlad(folder: Path) -> Callable[..., NetVLAD]:
    """What makes a method of a family, or of a file of it."""
    return lambda family, path=None, **more: NETWORKS[family].method(path or NETWORKS[family].file(folder), **more)


@with_checks(*NETWORKS.values())
def test_it_is_the_published_network(check, folder: Path) -> None:
    check(folder)


def test_one_network_gives_one_descriptor_in_two_layouts_when_the_whitening_is_permuted(netvlad, folder: Path) -> None:
    channel_fastest = drawn(4, 6)
    shuffled = channel_fastest["WPCA.0.weight"].reshape(6, 4, 512).transpose(1, 2).reshape(6, 2048, 1, 1)
    cluster_fastest = of_levels(channel_fastest) | {"WPCA.0.weight": shuffled}
    images = drawn_images(*SIZES)
    c = encoded(netvlad("patch-netvlad", write_checkpoint(folder / "c.pth.tar", channel_fastest)), *images)
    a_file = write_struct(folder / "a.mat", cluster_fastest, 255 * IMAGENET[0])
    assert distance(encoded(netvlad("matconvnet", a_file), *images), c) < 1e-4


@pytest.mark.parametrize(
    ("size", "target"),
    [((1080, 1920), (576, 1024)), ((1500, 1000), (1024, 683)), ((1024, 768), (1024, 768)), ((300, 400), (300, 400))],
)
def test_only_images_of_more_than_the_longest_side_change_their_size(size, target, netvlad) -> None:
    assert netvlad("matconvnet", longest_side=1024).target(*size) == target


def parallel(tensors: Tensors) -> Tensors:
    return {re.sub(r"^(encoder|pool)\.", r"\1.module.", name): tensor for name, tensor in tensors.items()}


RECALLS = {"recalls": {1: np.float64(0.852), 5: np.float64(0.948)}, "best_score": np.float64(0.948)}


@pytest.mark.parametrize(("change", "extras"), [(parallel, {}), (dict, RECALLS)], ids=["parallel", "recalls"])
def test_other_forms_of_a_checkpoint_are_read(change, extras: dict[str, Any], netvlad, folder: Path) -> None:
    own = NETWORKS["pytorch"]
    path = write_checkpoint(folder / "other.pth.tar", change(own.tensors), **extras)
    assert np.array_equal(encoded(netvlad("pytorch", path), *own.images), own.codes(folder))


def test_a_whitening_stored_as_float64_is_used_as_float32(netvlad, folder: Path) -> None:
    path = NETWORKS["patch-netvlad"].file(folder)
    assert torch.load(path)["state_dict"]["WPCA.0.weight"].dtype == torch.float64
    network = netvlad("patch-netvlad").load(path)
    assert {values.dtype for values in network.state_dict().values()} == {torch.float32}


def test_the_mean_is_that_of_the_file_even_if_it_is_one_pixel(netvlad, folder: Path) -> None:
    own = NETWORKS["matconvnet"]
    path = write_struct(folder / "one.mat", own.tensors)
    content = scipy.io.loadmat(path)
    content["net"]["meta"][0, 0]["normalization"][0, 0]["averageImage"][0, 0] = AVERAGE[None, None]
    scipy.io.savemat(path, {"net": content["net"]})
    assert np.array_equal(encoded(netvlad("matconvnet", path), *own.images), own.codes(folder))


@pytest.mark.parametrize(
    ("family", "other", "complaint"),
    [
        ("matconvnet", "patch-netvlad", "MatConvNet"),
        ("pytorch", "patch-netvlad", "WPCA.0.weight"),
        ("patch-netvlad", "pytorch", "WPCA.0.weight"),
        ("patch-netvlad", "matconvnet", "torch"),
    ],
)
def test_a_file_of_another_family_is_refused(family: str, other: str, complaint: str, folder: Path) -> None:
    assert complaint in NETWORKS[family].refusal(NETWORKS[other].file(folder))


def test_a_file_of_another_method_is_refused(folder: Path) -> None:
    resnet = oracle.resnet_checkpoint(torch.Generator().manual_seed(0), "resnet18", "backbone.")
    told = NETWORKS["patch-netvlad"].refusal(write_checkpoint(folder / "x.pth", resnet))
    assert "encoder.0.weight" in told
    assert "backbone" in told


MATLAB_OBJECT = scipy.io.matlab.MatlabObject(np.zeros((1, 1), [("a", object)]), "dagnn.DagNN")
MATLAB_OBJECTS = cell(*[scipy.io.matlab.MatlabObject(np.zeros((1, 1), [("a", object)]), "layerVLAD")] * 35)
META = {"normalization": {"averageImage": np.zeros((1, 1, 3))}}


@pytest.mark.parametrize(
    "content",
    [
        {"other": 1.0},
        {"net": 1.0},
        {"net": MATLAB_OBJECT},
        {"net": {"layers": MATLAB_OBJECTS, "meta": META}},
        {"net": {"layers": cell(*[layer("relu")] * 35), "meta": {"x": 1.0}}},
        {"net": {"layers": cell(*[layer("relu")] * 34), "meta": META}},
        {"net": {"layers": cell(*[layer("relu")] * 35), "meta": META}},
        {"net": {"layers": 1.0, "meta": META}},
    ],
    ids=["no net", "a number", "an object", "objects", "no mean", "34 layers", "no weights", "no layers"],
)
def test_a_mat_of_another_structure_is_refused_with_what_is_wanted(content: dict[str, Any], folder: Path) -> None:
    scipy.io.savemat(folder / "x.mat", content)
    assert "MatConvNet" in NETWORKS["matconvnet"].refusal(folder / "x.mat")


HDF5 = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + bytes(400)


@pytest.mark.parametrize("content", [b"", b"<html>", HDF5, None], ids=["empty", "a page", "HDF5", "cut off"])
def test_what_is_no_mat_is_refused(content: bytes | None, folder: Path) -> None:
    own = NETWORKS["matconvnet"]
    path = folder / "x.mat"
    path.write_bytes(own.file(folder).read_bytes()[:100_000] if content is None else content)
    assert "MatConvNet" in own.refusal(path)


def test_the_yaml_states_sizes_and_hashes() -> None:
    pitts = composed("method=netvlad")["weights"]["stated"]
    assert pitts == {
        "Pitts30K_struct.mat": {
            "sha256": "a67d9d897d3b7942f206478e3a22a4c4c9653172ae2447041d35f6cb278fdc67",
            "certain": False,
        }
    }
    stated = composed("method=netvlad_msls")["weights"]["stated"]
    assert {name: (one.get("size_bytes"), one["sha256"][:8], len(one["sha256"])) for name, one in stated.items()} == {
        "mapillary_WPCA128.pth.tar": (67319611, "5b6de8a5", 64),
        "mapillary_WPCA512.pth.tar": (92488008, "acbe2597", 64),
        "mapillary_WPCA4096.pth.tar": (327398210, "4b22ad16", 64),
        "pitts_WPCA128.pth.tar": (92681537, "74bb0e01", 64),
        "pitts_WPCA512.pth.tar": (None, "309611d9", 64),
        "pitts_WPCA4096.pth.tar": (1132901186, "2c3cf17d", 64),
    }
