"""Networks on VGG16 and ResNets, each against a float64 version written from the key names of its files."""

import sys
from types import ModuleType

import backbones_oracle as oracle
import numpy as np
import pytest
import torch
from backbones_oracle import Draw, gem, imagenet, linear, prefixed, under
from described_images import distance, drawn_images, encoded, pillow
from PIL import Image as PillowImage
from published_networks import PublishedNetwork, saved_training, with_checks
from sklearn.decomposition import PCA
from torch.nn import functional

from vprbench.errors import BadInput

pytestmark = pytest.mark.extended  # published networks at full size


# CosPlace and EigenPlaces


def draw_cosplace():
    draw = Draw(5)
    return prefixed("backbone.", oracle.vgg16_checkpoint(draw)) | {
        "aggregation.1.p": torch.tensor([2.4]),
        "aggregation.3.weight": draw.normal(64, 512),  # the pooling gives a few hundredths
        "aggregation.3.bias": draw.normal(64, scale=0.3),
    }


def described_by_cosplace(tensors, seen):
    t = under(tensors, "")
    features = functional.normalize(oracle.vgg16(t, "backbone.", imagenet(seen), 28), dim=1)
    return linear(t, "aggregation.3", gem(features, t["aggregation.1.p"])[0])


COSPLACE = PublishedNetwork(
    "cosplace",
    draw_cosplace,
    drawn_images((64, 96), (71, 53), (71, 53), (64, 96)),
    64,
    described_by_cosplace,
    arguments={"backbone": "VGG16", "n_dimensions": 64},
    tolerance=1e-4,
    refused=[("16 pixels", {}, (40, 15)), ("other", {"n_dimensions": 128}, (64, 96))],
)


# GCL; its whitening has tests of its own


def draw_gcl(kind, pooling="GeM"):
    draw = Draw(len(kind))
    backbone = oracle.vgg16_checkpoint(draw) if kind == "vgg16" else oracle.resnet_checkpoint(draw, kind)
    return prefixed("backbone.", backbone) | ({"pool.p": torch.tensor([2.4])} if pooling == "GeM" else {})


def described_by_gcl(tensors, seen, kind="vgg16", pooling="GeM"):
    backbone = oracle.vgg16 if kind == "vgg16" else oracle.resnet
    features = backbone(tensors, "backbone.", imagenet(pillow(seen, 64, 96)))
    if pooling == "GeM":
        return gem(features, tensors["pool.p"])[0]
    return (features.mean((2, 3)) if pooling == "avg" else features.amax((2, 3)))[0]


GCL = PublishedNetwork(
    "gcl",
    lambda: draw_gcl("vgg16"),
    drawn_images((131, 187), (64, 96), (131, 187), (70, 51)),
    512,
    described_by_gcl,
    saved_training,
    arguments={"height": 64, "width": 96, "backbone": "vgg16"},
    tolerance=1e-4,
    refused=[
        ("32 pixels", {"height": 31}, (64, 96)),
        *(("unexpected", other, (64, 96)) for other in ({"pooling": "avg"}, {"backbone": "resnet50"})),
    ],
)


@pytest.mark.parametrize(
    ("backbone", "kind", "pooling"),
    [
        ("resnet50", "resnet50", "GeM"),
        ("resnext", "resnext101_32x8d", "GeM"),
        ("vgg16", "vgg16", "avg"),
        ("vgg16", "vgg16", "max"),
    ],
)
def test_other_backbones_and_poolings_of_gcl_are_those_of_the_published_layout(backbone, kind, pooling, folder):
    tensors, seen = draw_gcl(kind, pooling), GCL.images[0]
    method = GCL.method(saved_training(folder / "other.pth", tensors), backbone=backbone, pooling=pooling)
    wanted = GCL.slowly(seen, tensors=tensors, kind=kind, pooling=pooling)
    assert distance(encoded(method, seen), wanted) < 1e-4


# MixVPR, of 4x6 positions


def draw_mixvpr(n_positions=24, channels=16, rows=3):
    draw = Draw(5)
    tensors = oracle.resnet_checkpoint(draw, "resnet50", "backbone.model.", n_stages=3, numbered=False)
    for at in (f"aggregator.mix.{number}.mix" for number in range(4)):
        tensors |= draw.norm(f"{at}.0", n_positions)
        tensors |= draw.linear(f"{at}.1", n_positions, n_positions) | draw.linear(f"{at}.3", n_positions, n_positions)
    tensors |= draw.linear("aggregator.channel_proj", 1024, channels)
    return tensors | draw.linear("aggregator.row_proj", n_positions, rows)


def described_by_mixvpr(tensors, seen):
    """The rows of each output channel side by side; levels are rounded before they become floats."""
    t, x = under(tensors, "aggregator."), imagenet(pillow(seen, 64, 96))
    x = oracle.resnet(tensors, "backbone.model.", x).flatten(2)
    for number in range(4):
        m = under(t, f"mix.{number}.mix.")
        inner = oracle.layer_norm(x, m["0.weight"], m["0.bias"], eps=1e-5)
        x = x + linear(m, "3", linear(m, "1", inner).clamp(min=0))
    return linear(t, "row_proj", linear(t, "channel_proj", x.mT).mT)[0].flatten()


MIXVPR = PublishedNetwork(
    "mixvpr",
    draw_mixvpr,
    drawn_images((64, 96), (131, 187), (131, 187), (71, 53)),
    48,
    described_by_mixvpr,
    arguments={"height": 64, "width": 96, "n_dimensions": 48},
    tolerance=1e-4,
    refused=[
        ("other", {"n_dimensions": 4096}, (64, 96)),
        *(("weights are for 24", {side: None}, (90, 120)) for side in ("height", "width")),
    ],
)


# Conv-AP, of 3x5 positions, of which the middle ones count in two quarters

CHANNELS = 6


def draw_conv_ap():
    draw = Draw(4)
    return oracle.resnet_checkpoint(draw, "resnet50", "backbone.model.", numbered=False) | {
        "aggregator.channel_pool.weight": draw.normal(CHANNELS, 2048, 1, 1, scale=1 / 45),
        "aggregator.channel_pool.bias": draw.normal(CHANNELS, scale=0.3),
    }


def described_by_conv_ap(tensors, seen):
    t, x = under(tensors, "aggregator.channel_pool."), imagenet(pillow(seen, 96, 160, PillowImage.Resampling.BICUBIC))
    features = oracle.resnet(tensors, "backbone.model.", x)
    maps = functional.conv2d(features, t["weight"], t["bias"])[0]
    return functional.adaptive_avg_pool2d(maps, 2).flatten()


CONV_AP = PublishedNetwork(
    "conv_ap",
    draw_conv_ap,
    drawn_images((131, 187), (96, 160)),
    4 * CHANNELS,
    described_by_conv_ap,
    arguments={"channels": CHANNELS, "height": 96, "width": 160},
    tolerance=1e-4,
)


# AP-GeM, whose PCA is a pickled object of a module of 2019, which is there while a file is written alone

DIMENSIONS, MODULE = 12, ModuleType("sklearn.decomposition.pca")
SPREAD = np.geomspace(1, 0.05, DIMENSIONS)
FITTED = PCA(whiten=True).fit(np.random.default_rng(0).normal(size=(40, DIMENSIONS)) * SPREAD + 0.1)


def draw_ap_gem(kind="resnet101", n_features=2048):
    draw = Draw(6)
    tensors = oracle.resnet_checkpoint(draw, kind, numbered=False) | {"adpool.p": torch.tensor([2.6])}
    tensors["fc.weight"] = draw.normal(DIMENSIONS, n_features, scale=1 / 45)
    tensors["fc.bias"] = draw.normal(DIMENSIONS, scale=0.3)
    return prefixed("module.", tensors)


def written_by_ap_gem(path, tensors, **changes):
    """Write what the published file holds, as torch and numpy wrote it in 2019."""
    MODULE.PCA = type("PCA", (), {"__module__": MODULE.__name__})
    vars(pca := MODULE.PCA()).update(FITTED.__getstate__())
    content = {"model_options": {"pooling": "gem"}, "state_dict": dict(tensors), "pca": {"Landmarks_clean": pca}}
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, MODULE.__name__, MODULE)
        torch.save(content | changes, path, _use_new_zipfile_serialization=False)
    path.write_bytes(path.read_bytes().replace(b"cnumpy._core.multiarray\n", b"cnumpy.core.multiarray\n"))
    return path


def described_by_ap_gem(tensors, seen, unit_features=False):
    t = under(tensors, "module.")
    pooled = gem(oracle.resnet(t, "", imagenet(seen)), t["adpool.p"])[0]
    pooled = pooled / pooled.norm() if unit_features else pooled
    vector = linear(t, "fc", pooled)
    whitened = ((vector / vector.norm()).numpy() - FITTED.mean_) @ FITTED.components_.T
    return whitened / FITTED.explained_variance_**0.25


AP_GEM = PublishedNetwork(
    "ap_gem",
    draw_ap_gem,
    drawn_images((64, 96), (71, 53)),
    DIMENSIONS,
    described_by_ap_gem,
    written_by_ap_gem,
    tolerance=1e-4,
)


@pytest.fixture
def small(monkeypatch):
    """Tensors of a smaller backbone, where it is not the backbone that matters."""
    monkeypatch.setattr("vprbench.methods.ap_gem._BACKBONE", "resnet18")
    return draw_ap_gem("resnet18", 512)


def test_pooled_features_get_unit_length_where_the_file_says_so_and_the_pickled_pca_runs_no_code(
    folder, small, monkeypatch
):
    path, seen = written_by_ap_gem(folder / "unit.pt", small, model_options={"norm_features": True}), AP_GEM.images[0]
    monkeypatch.setitem(sys.modules, MODULE.__name__, MODULE)
    monkeypatch.setattr(MODULE.PCA, "__setstate__", lambda *_: pytest.fail("code of the file ran"), raising=False)
    wanted = AP_GEM.slowly(seen, tensors=small, unit_features=True)
    assert distance(encoded(AP_GEM.method(path), seen), wanted) < 1e-4


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"pca": {"Landmarks_clean": torch.zeros(3)}}, "holds no pca of Landmarks_clean"),
        ({"state_dict": {"fc.bias": torch.zeros(DIMENSIONS)}}, r"missing \(conv1.weight"),
        ({"argument": np.random.RandomState}, "holds more than tensors"),
    ],
)
def test_another_file_than_that_of_ap_gem_is_refused(changes, told, folder, small):
    path = written_by_ap_gem(folder / "other.pt", small, **changes)
    with pytest.raises(BadInput, match=told):
        AP_GEM.method(path).load(path)


@with_checks(COSPLACE, GCL, MIXVPR, CONV_AP, AP_GEM)
def test_it_is_the_published_network(check, folder):
    check(folder)
