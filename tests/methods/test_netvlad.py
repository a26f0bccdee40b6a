"""NetVLAD in its three published layouts, against a float64 version written from the key names of the files."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import backbones_oracle as oracle
import numpy as np
import pytest
import scipy.io
import torch
from described_images import composed, drawn_images
from PIL import Image as PillowImage
from torch import Tensor
from torch.nn import functional

from vprbench.api.images import Images
from vprbench.api.weights import Weights
from vprbench.errors import BadInput
from vprbench.methods.netvlad import NetVLAD
from vprbench.plugins import conformance

IMAGENET = np.array([[0.485, 0.456, 0.406], [0.229, 0.224, 0.225]])
AVERAGE = np.array([117.5, 120.25, 90.75])  # of the .mat; unlike the usual mean, so that only the file's will do
SIZES = [(64, 96), (49, 70), (64, 96)]
FAMILIES = ("matconvnet", "pytorch", "patch-netvlad")

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


def netvlad(path: Path, family: str = "patch-netvlad", **arguments: Any) -> NetVLAD:
    arguments = {"whiten": family != "pytorch", **arguments}
    return NetVLAD(weights=Weights("x", "", "", path=str(path)), family=family, **arguments)


pictures = drawn_images


def pillow(image: np.ndarray, height: int, width: int) -> np.ndarray:
    return np.asarray(PillowImage.fromarray(image).resize((width, height), PillowImage.Resampling.BILINEAR))


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


@pytest.fixture(scope="module")
def networks() -> dict[str, Tensors]:
    """Random networks of the three layouts."""
    return {
        "matconvnet": of_levels(drawn(64, 8, seed=1)),
        "pytorch": drawn(5, seed=2),
        "patch-netvlad": drawn(4, 6, seed=3),
    }


def of_levels(tensors: Tensors) -> Tensors:
    """The same network for inputs that are 0 to 255 and not divided by deviations."""
    scale = torch.tensor(255 * IMAGENET[1], dtype=torch.float32)[:, None, None]
    return tensors | {"encoder.0.weight": tensors["encoder.0.weight"] / scale}


@pytest.fixture(scope="module")
def files(networks: dict[str, Tensors], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("netvlad")
    return {
        "matconvnet": write_struct(folder / "Pitts30K_struct.mat", networks["matconvnet"]),
        "pytorch": write_checkpoint(folder / "checkpoint.pth.tar", networks["pytorch"]),
        "patch-netvlad": write_checkpoint(folder / "WPCA6.pth.tar", networks["patch-netvlad"], num_pcs=6),
    }


@pytest.fixture(scope="module")
def codes(files: dict[str, Path]) -> dict[str, np.ndarray]:
    """What each family gives for images of two sizes in one call."""
    return {family: netvlad(files[family], family).encode(Images.from_arrays(pictures(*SIZES))) for family in FAMILIES}


@pytest.mark.parametrize("family", FAMILIES)
def test_descriptors_equal_the_slow_version(family: str, networks, codes) -> None:
    n_dimensions = {"matconvnet": 8, "pytorch": 5 * 512, "patch-netvlad": 6}[family]
    assert codes[family].shape == (3, n_dimensions)
    np.testing.assert_allclose(np.linalg.norm(codes[family], axis=1), 1, atol=1e-5)
    assert codes[family].dtype == np.float32
    np.testing.assert_allclose(codes[family], expected(networks[family], pictures(*SIZES), family), atol=1e-4)


@pytest.mark.parametrize(
    ("family", "trap"),
    [
        ("matconvnet", {"cluster_fastest": False}),
        ("matconvnet", {"levels": False}),
        ("matconvnet", {"sign": -1.0}),
        ("pytorch", {"cluster_fastest": True}),
        ("pytorch", {"levels": True}),
        ("patch-netvlad", {"cluster_fastest": True}),
        ("patch-netvlad", {"levels": True}),
        *((family, {"last": 29}) for family in FAMILIES),
        *((family, {"last": 30}) for family in FAMILIES),
        *((family, {"unit_locals": False}) for family in FAMILIES),
        *((family, {"intra": False}) for family in FAMILIES),
    ],
    ids=str,
)
def test_a_trap_that_is_stepped_into_would_show(family: str, trap: dict[str, Any], networks, codes) -> None:
    wrong = expected(networks[family], pictures(*SIZES)[1:2], family, **trap)
    assert np.abs(wrong - codes[family][1]).max() > 2e-3


def test_one_network_gives_one_descriptor_in_two_layouts_when_the_whitening_is_permuted(tmp_path: Path) -> None:
    channel_fastest = drawn(4, 6)
    shuffled = channel_fastest["WPCA.0.weight"].reshape(6, 4, 512).transpose(1, 2).reshape(6, 2048, 1, 1)
    cluster_fastest = of_levels(channel_fastest) | {"WPCA.0.weight": shuffled}
    images = Images.from_arrays(pictures(*SIZES))
    c = netvlad(write_checkpoint(tmp_path / "c.pth.tar", channel_fastest)).encode(images)
    a_file = write_struct(tmp_path / "a.mat", cluster_fastest, 255 * IMAGENET[0])
    np.testing.assert_allclose(netvlad(a_file, "matconvnet").encode(images), c, atol=1e-4)


@pytest.mark.parametrize("family", ["matconvnet", "patch-netvlad"])
def test_without_whitening_the_order_is_that_of_the_family(family: str, networks, files) -> None:
    images = pictures((64, 96))
    vlad = netvlad(files[family], family, whiten=False).encode(Images.from_arrays(images))
    assert vlad.shape[1] == 512 * len(networks[family]["pool.centroids"])
    np.testing.assert_allclose(vlad, expected(networks[family], images, family, whiten=False), atol=1e-4)


@pytest.mark.parametrize("family", FAMILIES)
def test_fewer_dimensions_are_the_first_at_unit_length(family: str, networks, files) -> None:
    images = pictures((49, 70))
    few = netvlad(files[family], family, n_dimensions=3).encode(Images.from_arrays(images))
    np.testing.assert_allclose(few, expected(networks[family], images, family, keep=3), atol=1e-4)


@pytest.mark.parametrize(("family", "most"), [("matconvnet", 8), ("pytorch", 2560), ("patch-netvlad", 6)])
def test_more_dimensions_than_the_file_gives_are_refused(family: str, most: int, files) -> None:
    with pytest.raises(BadInput, match=rf"^method.n_dimensions={most + 1}: .* gives {most}, ask for no more$"):
        netvlad(files[family], family, n_dimensions=most + 1).encode(Images.from_arrays(pictures((32, 32))))


@pytest.mark.parametrize("family", FAMILIES)
def test_a_batch_gives_what_single_images_give(family: str, files) -> None:
    images, method = Images.from_arrays(pictures(*[(48, 64)] * 3)), netvlad(files[family], family, batch_size=3)
    singles = np.concatenate([method.encode(images[i : i + 1]) for i in range(3)])
    np.testing.assert_allclose(method.encode(images), singles, atol=1e-5)


def test_the_same_images_give_the_same_descriptors(codes, files) -> None:
    again = netvlad(files["patch-netvlad"]).encode(Images.from_arrays(pictures(*SIZES)))
    np.testing.assert_array_equal(again, codes["patch-netvlad"])


def test_images_are_resized_antialiased_as_pillow_does(networks, files) -> None:
    images = pictures((150, 210))
    code = netvlad(files["patch-netvlad"], height=48, width=64).encode(Images.from_arrays(images))
    right = expected(networks["patch-netvlad"], images, resized=lambda image: pillow(image, 48, 64))
    aliased = expected(networks["patch-netvlad"], images, resized=lambda image: image[1::3, 1::3][:48, :64])
    np.testing.assert_allclose(code, right, atol=1e-4)
    assert np.abs(code - aliased).max() > 1e-2


def test_an_image_that_is_too_long_shrinks_to_unrounded_means(networks, files) -> None:
    images = pictures((128, 192))
    code = netvlad(files["matconvnet"], "matconvnet", longest_side=96, resize="area").encode(Images.from_arrays(images))
    levels = networks["matconvnet"], images, "matconvnet"
    right = expected(*levels, resized=lambda image: image.reshape(64, 2, 96, 2, 3).mean((1, 3)))
    other = expected(*levels, resized=lambda image: pillow(image, 64, 96))
    np.testing.assert_allclose(code, right, atol=1e-4)
    assert np.abs(code - other).max() > 1e-3


@pytest.mark.parametrize(
    ("size", "target"),
    [((1080, 1920), (576, 1024)), ((1500, 1000), (1024, 683)), ((1024, 768), (1024, 768)), ((300, 400), (300, 400))],
)
def test_only_images_of_more_than_the_longest_side_change_their_size(size, target) -> None:
    assert netvlad(Path("x"), "matconvnet", longest_side=1024).target(*size) == target


def test_prefixes_of_parallel_training_are_left_out(networks, codes, tmp_path: Path) -> None:
    parallel = {
        re.sub(r"^(encoder|pool)\.", r"\1.module.", name): tensor for name, tensor in networks["pytorch"].items()
    }
    assert "encoder.module.0.weight" in parallel
    method = netvlad(write_checkpoint(tmp_path / "parallel.pth.tar", parallel), "pytorch")
    np.testing.assert_array_equal(method.encode(Images.from_arrays(pictures(*SIZES))), codes["pytorch"])


def test_a_whitening_stored_as_float64_is_used_as_float32(files) -> None:
    assert torch.load(files["patch-netvlad"])["state_dict"]["WPCA.0.weight"].dtype == torch.float64
    network = netvlad(files["patch-netvlad"]).load(files["patch-netvlad"])
    assert {values.dtype for values in network.state_dict().values()} == {torch.float32}


def test_the_mean_is_that_of_the_file_even_where_it_is_one_pixel(networks, codes, tmp_path: Path) -> None:
    path = write_struct(tmp_path / "one.mat", networks["matconvnet"])
    content = scipy.io.loadmat(path)
    content["net"]["meta"][0, 0]["normalization"][0, 0]["averageImage"][0, 0] = AVERAGE[None, None]
    scipy.io.savemat(path, {"net": content["net"]})
    method = netvlad(path, "matconvnet")
    np.testing.assert_array_equal(method.encode(Images.from_arrays(pictures(*SIZES))), codes["matconvnet"])


def without(tensors: Tensors, name: str) -> Tensors:
    return {key: value for key, value in tensors.items() if key != name}


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda t: without(t, "encoder.28.bias"), r"1 missing \(encoder.28.bias\)"),
        (lambda t: without(t, "pool.centroids"), r"1 missing \(pool.centroids\)"),
        (lambda t: without(t, "WPCA.0.bias"), r"1 missing \(WPCA.0.bias\)"),
        (lambda t: t | {"pool.conv.bias": torch.zeros(4)}, r"1 unexpected \(pool.conv.bias\)"),
        (lambda t: t | {"encoder.5.bias": torch.zeros(64)}, r"1 other \(encoder.5.bias real \(64,\), wanted"),
        (lambda t: t | {"pool.centroids": torch.zeros(5, 512)}, r"pool.conv.weight real \(4, 512, 1, 1\), wanted"),
    ],
)
def test_a_file_with_other_tensors_is_refused(change, complaint: str, networks, tmp_path: Path) -> None:
    path = write_checkpoint(tmp_path / "x.pth.tar", change(networks["patch-netvlad"]))
    with pytest.raises(BadInput, match=complaint):
        netvlad(path).load(path)


@pytest.mark.parametrize(
    ("family", "other", "complaint"),
    [
        ("matconvnet", "patch-netvlad", "is no such file .*wanted a MatConvNet network converted to plain structs"),
        ("pytorch", "patch-netvlad", r"2 unexpected \(WPCA.0.weight, WPCA.0.bias\)"),
        ("patch-netvlad", "pytorch", r"2 missing \(WPCA.0.weight, WPCA.0.bias\)"),
        ("patch-netvlad", "matconvnet", "cannot be read as a file of torch|no file of torch"),
    ],
)
def test_a_file_of_another_family_is_refused(family: str, other: str, complaint: str, files) -> None:
    with pytest.raises(BadInput, match=complaint) as refused:
        netvlad(files[other], family).load(files[other])
    assert "\n" not in str(refused.value)


def test_a_file_of_another_method_is_refused(tmp_path: Path) -> None:
    resnet = oracle.resnet_checkpoint(torch.Generator().manual_seed(0), "resnet18", "backbone.")
    path = write_checkpoint(tmp_path / "x.pth", resnet)
    with pytest.raises(BadInput, match=r"missing \(encoder.0.weight, .*unexpected \(backbone"):
        netvlad(path).load(path)


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
def test_a_mat_of_another_structure_is_refused_with_what_is_wanted(content: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "x.mat"
    scipy.io.savemat(path, content)
    with pytest.raises(BadInput, match="wanted a MatConvNet network converted to plain structs") as refused:
        netvlad(path, "matconvnet").load(path)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("content", [b"", b"<html>", b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + bytes(400)])
def test_what_is_no_mat_is_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "x.mat"
    path.write_bytes(content)
    with pytest.raises(BadInput, match="wanted a MatConvNet network converted to plain structs"):
        netvlad(path, "matconvnet").load(path)


def test_a_damaged_mat_is_refused(files, tmp_path: Path) -> None:
    path = tmp_path / "x.mat"
    path.write_bytes(files["matconvnet"].read_bytes()[:100_000])
    with pytest.raises(BadInput, match="wanted a MatConvNet network converted to plain structs"):
        netvlad(path, "matconvnet").load(path)


def test_a_struct_of_other_shapes_is_refused(networks, tmp_path: Path) -> None:
    wrong = networks["matconvnet"] | {"WPCA.0.weight": torch.zeros(8, 1024, 1, 1)}
    path = write_struct(tmp_path / "x.mat", wrong)
    with pytest.raises(BadInput, match=r"1 other \(WPCA.0.weight real \(8, 1024, 1, 1\), wanted real \(8, 32768, 1, 1"):
        netvlad(path, "matconvnet").load(path)


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ({"family": "pytorch", "whiten": True}, "hold no whitening; set whiten=false"),
        ({"n_dimensions": 0}, "^method.n_dimensions=0: give at least 1"),
        ({"longest_side": 0}, "^method.longest_side=0: give at least 1"),
    ],
)
def test_arguments_that_do_not_fit_are_named(arguments: dict[str, Any], complaint: str) -> None:
    with pytest.raises(BadInput, match=complaint):
        netvlad(Path("none"), **arguments).encode(Images.from_arrays(pictures((32, 32))))


def test_an_image_of_less_than_one_local_descriptor_is_refused(files) -> None:
    with pytest.raises(BadInput, match="NetVLAD needs 16 pixels a side"):
        netvlad(files["pytorch"], "pytorch").encode(Images.from_arrays(pictures((15, 40))))


@pytest.mark.parametrize("family", FAMILIES)
def test_the_contract_is_kept(family: str, files) -> None:
    config = {
        "_target_": "vprbench.methods.netvlad.NetVLAD",
        "family": family,
        "whiten": family != "pytorch",
        "weights": {"file": "x", "licence": "", "trained_on": "", "path": str(files[family])},
        "height": 16,
        "width": 32,
    }
    assert [str(result) for result in conformance.check(config) if result.state == "broken"] == []


def test_the_licence_of_a_converted_file_is_that_of_its_origin() -> None:
    assert composed("method=netvlad")["weights"]["licence"].startswith("MIT, that of github.com/Relja/netvlad;")


def test_a_checkpoint_with_the_recalls_of_its_training_is_read(networks, codes, tmp_path: Path) -> None:
    progress = {"recalls": {1: np.float64(0.852), 5: np.float64(0.948)}, "best_score": np.float64(0.948)}
    path = write_checkpoint(tmp_path / "checkpoint.pth.tar", networks["pytorch"], **progress)
    found = netvlad(path, "pytorch").encode(Images.from_arrays(pictures(*SIZES)))
    np.testing.assert_array_equal(found, codes["pytorch"])


def test_the_file_of_the_pytorch_family_has_to_be_fetched_by_hand() -> None:
    weights = composed("method=netvlad_pytorch")["weights"]
    assert weights["url"] is None
    assert "https://drive.google.com/open?id=17luTjZFCX639guSVy00OUtzfTQo4AMF2" in weights["by_hand"]
    assert "checkpoints/checkpoint.pth.tar" in weights["by_hand"]


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
