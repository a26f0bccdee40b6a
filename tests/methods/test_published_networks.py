"""Every published network: its yaml, its published sizes, the contract, and what it sees of an image."""

from copy import deepcopy
from functools import cache

import cv2
import numpy as np
import pytest
import torch
from described_images import composed, drawn_images
from described_images import pillow as resized_by_pillow
from PIL import Image as PillowImage
from published_networks import excepted
from torch.nn import functional

from vprbench.api.images import Images
from vprbench.api.neural import NeuralDescriptor
from vprbench.plugins import registry


class SmallNetwork(torch.nn.Module):
    """Stands in a large network's place: means over nine parts of one convolution; remembers what it sees."""

    mean: tuple[float, ...] | None = None  # what NetVLAD asks for

    def __init__(self):
        super().__init__()
        self.convolution = torch.nn.Conv2d(3, 32, 8, stride=8)
        self.convolution.weight.data = torch.randn(32, 3, 8, 8, generator=torch.Generator().manual_seed(0))
        self.register_buffer("centres", torch.zeros(1))  # what AnyLoc sets

    def forward(self, images):
        self.seen = images
        return torch.nn.functional.adaptive_avg_pool2d(self.convolution(images), 3).flatten(1)


ENTRIES = registry.find_entries("method")
NETWORKS = [  # but for the one whose weights a package brings
    name
    for name, entry in ENTRIES.items()
    if issubclass(entry.target(), NeuralDescriptor) and not name.startswith("efficientnet")
]


#: The files whose names follow from options.
FILES = {
    "gcl method.backbone=resnext method.pooling=avg method.loss=CL": "MSLS_resnext_avg_480_CL.pth",
    "gcl_whitened": "MSLS_resnet152_GeM_480_GCL.pth",
    "mixvpr": "resnet50_MixVPR_4096_channels(1024)_rows(4).ckpt",
    "patch_netvlad": "mapillary_WPCA4096.pth.tar",
    "patch_netvlad method.configuration=speed": "mapillary_WPCA512.pth.tar",
}

BOQ = 3 * 384 + 2 * 2_983_296 + 129 * 32  # norm, two blocks of 64 queries with their encoders, last layer
#: The pixels of a side that a network without values is shown, the published dimensions, and the number of values.
SIZES = {
    "anyloc": (42, 49152, None),
    "ap_gem": (64, 2048, None),
    "boq": (42, 12288, 86_580_480 - 3 * 768 + 9 * 768 * 384 + BOQ),  # no mask token, no final norm
    "boq_resnet50": (64, 16384, 8_543_296 + 9 * 1024 * 512 + 3 * 512 + 2 * 5_288_448 + 129 * 32),
    "conv_ap": (32, 4096, None),
    "cosplace": (64, 2048, None),
    "cosplace method.backbone=ResNet152": (64, 2048, 58_143_808 + 1 + 2048 * 2049),
    "cricavpr": (224, 10752, None),
    # But for the mask token
    "dinov2 method.backbone=vits14": (42, 384, 22_056_576 - 384),
    "dinov2 method.backbone=vitg14": (42, 1536, 1_136_480_768 - 1536),
    "gcl": (64, 2048, None),
    "megaloc": (126, 8448, pytest.approx(228.6e6, abs=0.1e6)),
    "mixvpr": (320, 4096, 9_829_696 + 1025 * 1024 + 401 * 4),
    "netvlad": (64, 4096, 149_002_048),
    "netvlad_msls": (64, 4096, 14_714_688 + 2 * 16 * 512 + 4096 * 8192 + 4096),
    "netvlad_pytorch": (64, 32768, 14_714_688 + 2 * 64 * 512),
    # The image and the patches of 8x8 positions
    "patch_netvlad": (128, 4096 * (1 + 49 + 16 + 1), 14_714_688 + 2 * 16 * 512 + 4096 * 8193),
    "salad": (126, 8448, None),
    "sfrs": (64, 4096, None),
    "supervlad": (56, 3072, None),
    "supervlad_crossimage": (56, 3072, None),
}


@cache
def configured(words):
    name, *options = words.split(" method.")
    return composed(f"method={name}", *(f"method.{option}" for option in options))


def configuration(words):
    return deepcopy(configured(words))


#: One network of each class, and the networks whose settings change what they keep of the contract.
CONTRACT = {*{ENTRIES[name].target(): name for name in NETWORKS}.values(), "gcl_whitened", "supervlad_crossimage"}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.extended] * (name not in ("netvlad", "gcl")))
        for name in sorted(CONTRACT - {"patch_netvlad"})
    ],
)
def test_a_method_keeps_the_contract_with_a_small_network_in_place_of_its_own(name, tmp_path):
    config = configuration(name) | {"height": 56, "width": 56}
    for file in {"weights", "centres"} & set(config):
        config[file]["path"] = str(tmp_path / "there")
    (tmp_path / "there").touch()
    whitened = {"a batch gives what its single images give"}
    assert excepted(config, SmallNetwork()) == (whitened if name == "gcl_whitened" else set())


@pytest.mark.parametrize("words", [*NETWORKS, *(words for words in FILES if " " in words)])
def test_the_yaml_names_the_published_file_and_where_it_is_or_how_it_is_fetched_by_hand(words):
    weights = configuration(words)["weights"]
    file, url = weights["file"], weights["url"]
    assert file == FILES.get(words, file)
    assert (weights["by_hand"] is None) is (url is not None)
    assert words == "megaloc" or url is None or "drive.google.com" in url or url.endswith(f"/{file}")


@pytest.mark.parametrize("words", SIZES)
@pytest.mark.extended
def test_the_network_without_values_has_the_published_dimensions_and_number_of_values(words):
    side, n_dimensions, n_values = SIZES[words]
    with torch.device("meta"):
        network = registry.make_method(configuration(words)).blank()
        assert network(torch.zeros(2, 3, side, side)).shape == (2, n_dimensions)
    assert n_values is None or sum(values.numel() for values in network.parameters()) == n_values


# What they see of an image, in their authors' evaluation and in VPR-methods-evaluation

LARGE, SMALL = (768, 2048), (47, 61)
#: What networks see the levels of images less of; that of `netvlad` is its file's.
MEANS = {"netvlad": (117.5, 120.25, 90.75), "sfrs": (123.68, 116.779, 103.939)}


def shown(name, image, **changed):
    """A method, and what its network sees of an image, (height, width, 3)."""
    method = registry.make_method({**configuration(name), **changed})
    method.use(network := SmallNetwork())
    network.mean = MEANS[name] if name == "netvlad" else None
    method.encode(Images.from_arrays([image]))
    return method, network.seen[0].permute(1, 2, 0).double().numpy()


def pillow(side, how=PillowImage.Resampling.BILINEAR):
    return lambda image: resized_by_pillow(image, *side, how)


def floats(side, mode="bilinear"):
    def resized(image):
        levels = torch.from_numpy(image).permute(2, 0, 1)[None].double()
        if levels.shape[2:] != side:
            levels = functional.interpolate(levels, side, mode=mode, antialias=True, align_corners=False)
        return levels[0].permute(1, 2, 0).numpy()

    return resized


AUTHORS = [
    ("netvlad", LARGE, lambda image: image.reshape(384, 2, 1024, 2, 3).mean((1, 3))),  # hloc: at most 1024 pixels
    ("netvlad", SMALL, lambda image: image),
    ("netvlad_pytorch", LARGE, lambda image: image),
    ("netvlad_msls", LARGE, pillow((480, 640))),
    ("patch_netvlad", LARGE, pillow((480, 640))),
    ("gcl", LARGE, pillow((480, 640))),
    ("sfrs", LARGE, pillow((480, 640))),
    ("ap_gem", LARGE, lambda image: image),
    ("conv_ap", LARGE, pillow((320, 320), PillowImage.Resampling.BICUBIC)),
    ("cricavpr", LARGE, lambda image: cv2.resize(image, (224, 224))),
    ("supervlad", LARGE, floats((322, 322))),
    ("supervlad_crossimage", LARGE, floats((322, 322))),
    ("cosplace", LARGE, lambda image: image),
    ("eigenplaces", LARGE, lambda image: image),
    ("mixvpr", LARGE, pillow((320, 320))),
    ("dinov2", LARGE, pillow((322, 322))),  # this project's choice
    ("salad", LARGE, pillow((322, 322))),
    ("salad_indoor", SMALL, floats((42, 56))),
    ("boq", LARGE, floats((322, 322), "bicubic")),
    ("boq_resnet50", LARGE, floats((384, 384), "bicubic")),
    ("megaloc", SMALL, floats((42, 56))),
    ("anyloc", SMALL, lambda image: image[2:44, 2:58]),  # 42x56 from the middle: halves of a pixel go to even rows
    ("anyloc", LARGE, lambda image: floats((384, 1024), "bicubic")(image)[3:381, 1:1023]),
]


@pytest.mark.parametrize(("name", "size", "expected"), AUTHORS)
def test_images_are_seen_as_in_the_authors_evaluation(name, size, expected):
    (image,) = drawn_images(size)
    values, wanted = shown(name, image)[1], expected(image)
    usual = (values * [0.229, 0.224, 0.225] + [0.485, 0.456, 0.406]) * 255
    found = values + MEANS[name] if name in MEANS else usual  # as levels 0..255
    assert found.shape == wanted.shape
    assert np.abs(found - wanted).max() < 0.1


@pytest.mark.parametrize(
    ("name", "size"), [*((name, (200, 301)) for name in NETWORKS), ("netvlad", LARGE), ("anyloc", LARGE)]
)
def test_images_are_seen_as_in_vpr_methods_evaluation_by_every_network(name, size):
    (image,) = drawn_images(size)
    config = configuration(name)
    assert config["preprocessing"] == "authors"
    multiple = ENTRIES[name].target().multiple
    given = config["height"] or size[0], config["width"] or size[1]
    side = round(given[0] / multiple) * multiple, round(given[1] / multiple) * multiple
    asked = {"preprocessing": "vpr_methods_evaluation", "resize": "opencv", "interpolation": "bicubic"}
    method, found = shown(name, image, **asked)
    normalised = method.pixels(torch.from_numpy(image).permute(2, 0, 1)[None].double())[0].permute(1, 2, 0).numpy()
    wanted = floats(side)(normalised)
    assert found.shape == wanted.shape
    assert np.abs(found - wanted).max() < np.ptp(normalised) / 2000
