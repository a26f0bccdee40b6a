"""NetVLAD in its three published layouts, and SFRS, against a float64 version written from the names in the files."""

from functools import partial

import backbones_oracle as oracle
import numpy as np
import pytest
import scipy.io
import torch
from backbones_oracle import Draw, prefixed, under
from described_images import drawn_images
from mat_cells import cells
from published_networks import PublishedNetwork, saved, saved_training, with_checks

from vprbench.errors import BadInput

pytestmark = pytest.mark.extended  # published networks at full size

IMAGENET = np.array([[0.485, 0.456, 0.406], [0.229, 0.224, 0.225]])
AVERAGE = np.array([117.5, 120.25, 90.75])  # of the .mat; unlike the usual mean, so that only the file's will do
SFRS_MEAN = np.array([0.48501960784313836, 0.4579568627450961, 0.4076039215686255]) * 255  # as its authors have it
SIZES = [(64, 96), (49, 70), (64, 96)]


def drawn(clusters, components=None, of_levels=False):
    """Random tensors under the names of family C; without `components` those of family B."""
    tensors = oracle.netvlad_checkpoint(Draw(clusters), clusters, components)
    if of_levels:  # 0 to 255, not divided by deviations
        tensors["encoder.0.weight"] /= torch.tensor(255 * IMAGENET[1], dtype=torch.float32)[:, None, None]
    return tensors


def layer(kind, *weights):
    return {"type": kind, "name": kind, "weights": cells(weights).T}


def write_struct(path, tensors):
    """Write tensors, of which the whitening takes channels first, as MatConvNet keeps them."""
    t = {name: tensor.float().numpy() for name, tensor in tensors.items()}
    layers = [layer("pool" if number in oracle.VGG16_POOLS else "relu") for number in range(29)]
    for number in oracle.VGG16_CONVOLUTIONS:
        weight, bias = (t[f"encoder.{number}.{part}"] for part in ("weight", "bias"))
        layers[number] = layer("conv", weight.transpose(2, 3, 1, 0), bias[:, None])
    clusters = t["pool.conv.weight"][:, :, 0, 0].T[None, None], -t["pool.centroids"].T[None, None]
    whitening = t["WPCA.0.weight"][:, :, 0, 0].T[None, None], t["WPCA.0.bias"][:, None]
    layers += [layer("normalize"), layer("custom", *clusters), layer("custom"), layer("normalize")]
    layers += [layer("conv", *whitening), layer("normalize")]
    meta = {"normalization": {"averageImage": np.broadcast_to(AVERAGE, (5, 4, 3)), "imageSize": [224, 224, 3]}}
    scipy.io.savemat(path, {"net": {"layers": cells(layers).T, "meta": meta}})
    return path


def expected(family, tensors, image, whiten=True, keep=None):
    x = image.astype(np.float64)
    less = {"matconvnet": AVERAGE, "sfrs": SFRS_MEAN}
    x = x - less[family] if family in less else (x / 255 - IMAGENET[0]) / IMAGENET[1]
    features = oracle.vgg16(tensors, "encoder.", torch.from_numpy(x).permute(2, 0, 1)[None], 28)[0]
    sums = oracle.residuals(features, tensors["pool.conv.weight"], tensors["pool.centroids"]).sum(0)
    whitening = [tensors["WPCA.0.weight"], tensors["WPCA.0.bias"]] if whiten and family != "pytorch" else []
    return oracle.vlad(sums, *whitening, fastest="cluster" if family == "matconvnet" else "channel")[:keep]


SMALL, MIDDLE = drawn_images((49, 70), (64, 96))
OPTIONS = {
    "few dimensions": ({"n_dimensions": 3}, SMALL, {"keep": 3}),
    "unwhitened": ({"whiten": False}, MIDDLE, {"whiten": False}),
}
REFUSED = [
    ("method.n_dimensions=0", {"n_dimensions": 0}, (49, 70)),
    ("method.longest_side=0", {"longest_side": 0}, (32, 32)),
    ("16 pixels", {}, (15, 40)),
]


def network(name, family, n_dimensions, **more):
    own = {"family": family, "whiten": family != "pytorch", "longest_side": None, "resize": "pillow"}
    more |= {"images": drawn_images(*SIZES), "expected": partial(expected, family), "arguments": own}
    return PublishedNetwork(name, n_dimensions=n_dimensions, tolerance=1e-4, **more)


MATCONVNET = network(
    "netvlad",
    "matconvnet",
    8,
    draw=lambda: drawn(64, 8, of_levels=True),
    write=write_struct,
    options=OPTIONS,
    refused=[*REFUSED, ("method.n_dimensions=9", {"n_dimensions": 9}, (49, 70))],
)
PYTORCH = network(
    "netvlad_pytorch",
    "pytorch",
    5 * 512,
    draw=lambda: drawn(5),
    write=partial(saved_training, key="state_dict"),
    refused=[("method.whiten=true", {"whiten": True}, (32, 32)), ("=2561", {"n_dimensions": 2561}, (32, 32))],
)
MSLS = network(
    "netvlad_msls",
    "patch-netvlad",
    6,
    draw=lambda: drawn(4, 6),
    write=partial(saved_training, key="state_dict"),
    options=OPTIONS,
    refused=[("method.n_dimensions=7", {"n_dimensions": 7}, (49, 70))],
)


def save_sfrs(path, tensors):
    """Write tensors under the names that SFRS's file has for the parts."""
    names = {"encoder.": "base_model.base.", "pool.": "net_vlad.", "WPCA.0.": "pca_layer."}
    parts = [prefixed(other, under(tensors, own)) for own, other in names.items()]
    return saved(path, {name: tensor for part in parts for name, tensor in part.items()})


SFRS = PublishedNetwork(
    "sfrs",
    lambda: drawn(3, 8, of_levels=True),
    drawn_images(*SIZES[:2]),
    8,
    partial(expected, "sfrs"),
    save_sfrs,
    arguments={"height": None, "width": None},
    tolerance=1e-4,
    refused=REFUSED[2:],
)


@with_checks(MATCONVNET, PYTORCH, MSLS, SFRS)
def test_it_is_the_published_network(check, folder):
    check(folder)


MATLAB_OBJECT = scipy.io.matlab.MatlabObject(np.zeros((1, 1), [("a", object)]), "dagnn.DagNN")


@pytest.mark.parametrize(
    "content",
    [
        {"net": MATLAB_OBJECT},
        {"net": {"layers": cells([layer("relu")] * 35).T, "meta": {"x": 1.0}}},
        b"<html>",
        100_000,
    ],
    ids=["an object", "no mean", "a page", "cut off"],
)
def test_another_file_than_a_mat_of_this_structure_is_refused_with_what_is_wanted(content, folder):
    path = folder / "x.mat"
    if isinstance(content, dict):
        scipy.io.savemat(path, content)
    else:
        path.write_bytes(content if isinstance(content, bytes) else MATCONVNET.file(folder).read_bytes()[:content])
    with pytest.raises(BadInput, match=r"x\.mat .*MatConvNet"):
        MATCONVNET.method(path).load(path)
