"""NetVLAD in its three published layouts, against a float64 version written from the key names of the files."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import backbones_oracle as oracle
import numpy as np
import pytest
import scipy.io
import torch
from described_images import composed, distance, drawn_images, encoded, pillow
from published_networks import PublishedNetwork, saved, with_checks

from vprbench.api.arrays import Image
from vprbench.methods.netvlad import NetVLAD

IMAGENET = np.array([[0.485, 0.456, 0.406], [0.229, 0.224, 0.225]])
AVERAGE = np.array([117.5, 120.25, 90.75])  # of the .mat; unlike the usual mean, so that only the file's will do
SIZES = [(64, 96), (49, 70), (64, 96)]

Tensors = dict[str, torch.Tensor]


def drawn(clusters: int, components: int | None = None) -> Tensors:
    """Random tensors under the names of family C; without `components` those of family B."""
    draw = oracle.Draw(clusters)
    tensors = oracle.vgg16_checkpoint(draw, "encoder.")
    tensors["pool.centroids"] = draw.normal(clusters, 512, scale=512**-0.5)
    tensors["pool.conv.weight"] = draw.normal(clusters, 512, 1, 1, scale=4)
    if components is not None:
        tensors["WPCA.0.weight"] = draw.normal(components, clusters * 512, 1, 1).double()
        tensors["WPCA.0.bias"] = draw.normal(components, scale=0.5).double()
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
    return saved(path, {"epoch": 30, "state_dict": tensors, "optimizer": optimizer, "parallel": False, **extras})


def expected(
    family: str,
    tensors: Tensors,
    image: Image,
    resized: Callable[[Image], Image] = lambda image: image,
    whiten: bool = True,
    keep: int | None = None,
) -> torch.Tensor:
    x = resized(image).astype(np.float64)
    x = x - AVERAGE if family == "matconvnet" else (x / 255 - IMAGENET[0]) / IMAGENET[1]
    features = oracle.vgg16(tensors, "encoder.", torch.from_numpy(x).permute(2, 0, 1)[None], 28)[0]
    sums = oracle.residuals(features, tensors["pool.conv.weight"], tensors["pool.centroids"]).sum(0)
    whitening = [tensors["WPCA.0.weight"], tensors["WPCA.0.bias"]] if whiten and family != "pytorch" else []
    return oracle.vlad(sums, *whitening, fastest="cluster" if family == "matconvnet" else "channel")[:keep]


def of_levels(tensors: Tensors) -> Tensors:
    """The same network for inputs that are 0 to 255 and not divided by deviations."""
    scale = torch.tensor(255 * IMAGENET[1], dtype=torch.float32)[:, None, None]
    return tensors | {"encoder.0.weight": tensors["encoder.0.weight"] / scale}


def network(
    name: str, family: str, draw: Callable[[], Tensors], n_dimensions: int, options: dict[str, Any], **more: Any
) -> PublishedNetwork:
    whiten = family != "pytorch"
    small, large = drawn_images((49, 70), (64, 96))
    options |= {"few dimensions": ({"n_dimensions": 3}, small, {"keep": 3})}
    options |= {"unwhitened": ({"whiten": False}, large, {"whiten": False})}
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
        partial(expected, family),
        write_struct if family == "matconvnet" else write_checkpoint,
        arguments={"family": family, "whiten": whiten, "longest_side": None, "resize": "pillow"},
        tolerance=1e-4,
        alike_in_half=0.98,
        options=options,
        refused=refused,
        **more,
    )


NETWORKS = {
    "matconvnet": network(
        "netvlad",
        "matconvnet",
        lambda: of_levels(drawn(64, 8)),
        8,
        wrong={"WPCA.0.weight": (8, 1024, 1, 1)},
        options={
            "unrounded means of a long image": (
                {"longest_side": 96, "resize": "area"},
                drawn_images((128, 192))[0],
                {"resized": lambda image: image.reshape(64, 2, 96, 2, 3).mean((1, 3))},
            )
        },
    ),
    "pytorch": network("netvlad_pytorch", "pytorch", lambda: drawn(5), 5 * 512, {}, wrong={"WPCA.0.bias": (3, 3)}),
    "patch-netvlad": network(
        "netvlad_msls",
        "patch-netvlad",
        lambda: drawn(4, 6),
        6,
        wrong={
            "pool.centroids": None,
            "WPCA.0.weight": None,
            "pool.conv.bias": (3, 3),
            "encoder.5.bias": (63,),
        },
        options={
            "antialiased": (
                {"height": 48, "width": 64},
                drawn_images((150, 210))[0],
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


@pytest.mark.parametrize(
    ("size", "target"),
    [((1080, 1920), (576, 1024)), ((1500, 1000), (1024, 683)), ((1024, 768), (1024, 768)), ((3, 4000), (1, 1024))],
)
def test_only_images_of_more_than_the_longest_side_change_their_size(size, target, netvlad) -> None:
    assert netvlad("matconvnet", longest_side=1024).target(*size) == target


def parallel(tensors: Tensors) -> Tensors:
    return {re.sub(r"^(encoder|pool)\.", r"\1.module.", name): tensor for name, tensor in tensors.items()}


RECALLS = {"recalls": {1: np.float64(0.852), 5: np.float64(0.948)}, "best_score": np.float64(0.948)}


def test_other_forms_of_a_checkpoint_are_read(netvlad, folder: Path) -> None:
    own = NETWORKS["pytorch"]
    path = write_checkpoint(folder / "other.pth.tar", parallel(own.tensors), **RECALLS)
    assert np.array_equal(encoded(netvlad("pytorch", path), *own.images), own.codes(folder))


def test_a_whitening_stored_as_float64_is_used_as_float32(netvlad, folder: Path) -> None:
    assert NETWORKS["patch-netvlad"].tensors["WPCA.0.weight"].dtype == torch.float64
    network = netvlad("patch-netvlad").load(NETWORKS["patch-netvlad"].file(folder))
    assert {values.dtype for values in network.state_dict().values()} == {torch.float32}


def test_the_mean_is_that_of_the_file_even_if_it_is_one_pixel(netvlad, folder: Path) -> None:
    own = NETWORKS["matconvnet"]
    content = scipy.io.loadmat(own.file(folder))
    content["net"]["meta"][0, 0]["normalization"][0, 0]["averageImage"][0, 0] = AVERAGE[None, None]
    scipy.io.savemat(folder / "one.mat", {"net": content["net"]})
    code = encoded(netvlad("matconvnet", folder / "one.mat"), own.images[0])
    assert distance(code, own.codes(folder)[:1]) < 1e-6


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


MATLAB_OBJECT = scipy.io.matlab.MatlabObject(np.zeros((1, 1), [("a", object)]), "dagnn.DagNN")
META = {"normalization": {"averageImage": np.zeros((1, 1, 3))}}


@pytest.mark.parametrize(
    "content",
    [
        {"other": 1.0},
        {"net": MATLAB_OBJECT},
        {"net": {"layers": cell(*[MATLAB_OBJECT] * 35), "meta": META}},
        {"net": {"layers": cell(*[layer("relu")] * 35), "meta": {"x": 1.0}}},
        {"net": {"layers": cell(*[layer("relu")] * 34), "meta": META}},
        {"net": {"layers": cell(*[layer("relu")] * 35), "meta": META}},
        {"net": {"layers": 1.0, "meta": META}},
    ],
    ids=["no net", "an object", "objects", "no mean", "34 layers", "no weights", "no layers"],
)
def test_a_mat_of_another_structure_is_refused_with_what_is_wanted(content: dict[str, Any], folder: Path) -> None:
    scipy.io.savemat(folder / "x.mat", content)
    assert "MatConvNet" in NETWORKS["matconvnet"].refusal(folder / "x.mat")


@pytest.mark.parametrize("content", [b"", b"<html>", None], ids=["empty", "a page", "cut off"])
def test_what_is_no_mat_is_refused(content: bytes | None, folder: Path) -> None:
    own = NETWORKS["matconvnet"]
    path = folder / "x.mat"
    path.write_bytes(own.file(folder).read_bytes()[:100_000] if content is None else content)
    assert "MatConvNet" in own.refusal(path)


def test_the_yaml_states_sizes_and_hashes() -> None:
    ((name, pitts),) = composed("method=netvlad")["weights"]["stated"].items()
    assert (name, pitts["sha256"][:8], pitts["certain"]) == ("Pitts30K_struct.mat", "a67d9d89", False)
    stated = composed("method=netvlad_msls")["weights"]["stated"]
    assert {name: (one.get("size_bytes"), one["sha256"][:8]) for name, one in stated.items()} == {
        "mapillary_WPCA128.pth.tar": (67319611, "5b6de8a5"),
        "mapillary_WPCA512.pth.tar": (92488008, "acbe2597"),
        "mapillary_WPCA4096.pth.tar": (327398210, "4b22ad16"),
        "pitts_WPCA128.pth.tar": (92681537, "74bb0e01"),
        "pitts_WPCA512.pth.tar": (None, "309611d9"),
        "pitts_WPCA4096.pth.tar": (1132901186, "2c3cf17d"),
    }
    assert {len(one["sha256"]) for one in [pitts, *stated.values()]} == {64}
