"""Patch-NetVLAD: patches by direct loops in float64, matching and geometry on worked examples, and what it costs."""

import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import backbones_oracle as oracle
import cv2
import numpy as np
import pytest
from described_images import drawn_images, pillow
from published_networks import PublishedNetwork, saved_training, unit, with_checks
from scipy.stats import zscore
from torch import nn

from vprbench.api.images import Images
from vprbench.api.method import limit_batch_size
from vprbench.errors import BadInput
from vprbench.methods import netvlad, patch_netvlad
from vprbench.methods.patch_netvlad import PatchNetVLAD, count_inliers, score

pytestmark = pytest.mark.extended  # published networks at full size

SIDES = {"performance": (2, 5, 8), "speed": (5,), "storage": (5,)}
GEOMETRY = {"performance": "homography", "speed": "displacement", "storage": "displacement"}
SHARES = {"performance": (0.45, 0.15, 0.4), "speed": (1.0,), "storage": (1.0,)}


def described(tensors, seen, sides=(2, 5, 8)):
    """Descriptors of an image and of its patches, patch by patch, each of 10 numbers."""
    seen = pillow(seen, 144, 160)
    features = oracle.vgg16(tensors, "encoder.", oracle.imagenet(seen), 28)[0]
    residuals = oracle.residuals(features, tensors["pool.conv.weight"], tensors["pool.centroids"])
    grid = residuals.unflatten(0, (9, 10))
    sums = [grid.sum((0, 1))]
    for side in sides:
        places = [(y, x) for y in range(9 - side + 1) for x in range(10 - side + 1)]
        sums += [grid[y : y + side, x : x + side].mean((0, 1)) for y, x in places]
    whitening = tensors["WPCA.0.weight"], tensors["WPCA.0.bias"]
    return np.concatenate([oracle.vlad(one, *whitening).numpy() for one in sums])


NETWORK = PublishedNetwork(
    "patch_netvlad",
    lambda: oracle.netvlad_checkpoint(oracle.Draw(5), 3, 10),
    drawn_images((150, 170), (90, 90)),
    10 * (1 + 8 * 9 + 5 * 6 + 2 * 3),
    described,
    partial(saved_training, key="state_dict"),
    arguments={"components": dict.fromkeys(SIDES, 10), "height": 144, "width": 160},
    tolerance=1e-4,
    options={"one size": ({"configuration": "speed"}, drawn_images((90, 90))[0], {"sides": (5,)})},
    refused=[
        ("other", {"components": {"speed": 512}, "configuration": "speed"}, (150, 170)),
        ("method.height=None, method.width=160", {"height": None}, (32, 32)),
        ("128x128 pixels", {"width": 127}, (32, 32)),
        ("80x80 pixels", {"height": 79, "configuration": "speed"}, (32, 32)),
        ("method.candidates=0", {"candidates": 0}, (32, 32)),
        ("performance", {"components": {"speed": 512}}, (32, 32)),
    ],
)


def made(n_components=10, **arguments):
    return NETWORK.method(Path("none"), components=dict.fromkeys(SIDES, n_components), **arguments)


@with_checks(NETWORK)
def test_it_is_the_published_network(check, folder):
    check(folder)


@pytest.mark.parametrize("configuration", ["performance", "storage"])
def test_the_contract_is_kept(configuration, tmp_path, monkeypatch):
    """With one convolution in VGG16's place."""
    monkeypatch.setattr(netvlad, "build_vgg16", lambda **_: nn.Sequential(nn.Conv2d(3, 512, 16, stride=16)))
    draw = oracle.Draw()
    tensors = {name: t for name, t in oracle.netvlad_checkpoint(draw, 2, 24).items() if "encoder" not in name}
    tensors |= {"encoder.0.weight": draw.normal(512, 3, 16, 16, scale=1 / 16), "encoder.0.bias": draw.normal(512)}
    arguments = {"components": dict.fromkeys(SIDES, 24), "candidates": 2, "height": 128, "width": 128}
    network = replace(NETWORK, draw=lambda: tensors, arguments=arguments)
    assert network.check_contract(tmp_path, configuration=configuration) == set()


def test_the_bytes_of_a_code_are_known_and_the_smallest_codes_alone_are_kept(folder):
    assert NETWORK.method(NETWORK.file(folder)).code_bytes == NETWORK.codes(folder)[0].nbytes
    assert [made(configuration=each).keeps_descriptors() for each in SIDES] == [False, False, True]
    published = made(n_components=4096, height=480, width=640)
    assert published.code_bytes == 4 * 4096 * (1 + 1131 + 936 + 759)
    assert limit_batch_size(128, published.code_bytes) == 23


FOUR = [0, 4, 11, 13]


@pytest.mark.parametrize(
    ("geometry", "query", "reference", "wanted"),
    [
        ("homography", FOUR[:3], FOUR[:3], 0),  # a homography takes four pairs
        ("homography", FOUR, FOUR, 4 / 15),  # the share of patches that are inliers
        ("displacement", [], [], 0),
        ("displacement", [0, 6], [2, 6], 2 * (3**2 + 2**2) / 15),  # (2, 0) and (0, 0), their mean (1, 0)
        ("displacement", [0, 1, 5, 6], [1, 2, 6, 7], 4 * (4**2 + 2**2) / 15),  # all one to the right
    ],
)
def test_pairs_score_what_is_computed_by_hand(geometry, query, reference, wanted):
    pairs = np.array(query, np.int64), np.array(reference, np.int64)
    assert score(geometry, cells(3, 5), 2, pairs) == pytest.approx(wanted)


def cells(rows, columns):
    return np.array([(x, y) for y in range(rows) for x in range(columns)])


def test_points_are_inliers_within_24_pixels_of_the_query_image_whatever_was_asked_before():
    reference = np.random.default_rng(0).uniform((0, 0), (640, 480), (40, 2)).astype(np.float32)
    query, near, far = 4 * reference, reference.copy(), reference.copy()
    query[::4] += 90 * unit(np.random.default_rng(1).standard_normal((10, 2)))  # 22.5 pixels in the reference
    near[7, 0], far[7, 0] = near[7, 0] + 18, far[7, 0] + 40
    for seed in range(5):
        cv2.setRNGSeed(seed)
        assert [count_inliers(points, reference) for points in (query, near, far)] == [30, 40, 39]
    assert 0 <= count_inliers(reference[[0] * 6], reference[[0] * 6]) <= 6


N_PLACES, ROWS, COLUMNS, COMPONENTS = 7, 9, 10, 12


def made_up(configuration="performance"):
    """Made-up codes: two reference images a place, of which the patches are moved and noisy, and three queries."""
    generator = np.random.default_rng(4)
    n_patches = sum((ROWS - side + 1) * (COLUMNS - side + 1) for side in SIDES[configuration])
    base = generator.standard_normal((N_PLACES, 1 + n_patches, COMPONENTS))
    places = np.repeat(np.arange(N_PLACES), 2)[generator.permutation(2 * N_PLACES)]
    noise = generator.uniform(0.2, 0.9, (2 * N_PLACES, 1, 1))
    references = base[places] + noise * generator.standard_normal((2 * N_PLACES, *base.shape[1:]))
    queries = base[[2, 5, 0]] + 0.7 * generator.standard_normal((3, *base.shape[1:]))
    codes = unit(unit(np.concatenate([references, queries])).reshape(2 * N_PLACES + 3, -1)).astype(np.float32)
    images = Images.from_arrays([np.full((1, 1, 3), i, np.uint8) for i in range(len(codes))])
    return SimpleNamespace(places=places, codes=codes, references=images[:-3], queries=images[-3:])


def slow_score(configuration, query, other, side):
    """The score, which is worked by hand above, of the patches that are each other's nearest."""
    distances = np.linalg.norm(query[:, None] - other, axis=2)
    nearest, of_query = distances.argmin(0), distances.argmin(1)
    own = np.flatnonzero(of_query[nearest] == np.arange(len(other)))
    return score(GEOMETRY[configuration], cells(ROWS - side + 1, COLUMNS - side + 1), side, (nearest[own], own))


def slow_scores(world, code, configuration, n_candidates):
    """A query's scores, place by place."""
    query, *split = (unit(one.reshape(-1, COMPONENTS).astype(np.float64)) for one in (code, *world.codes[:-3]))
    found = [(float(own[0] @ query[0]), number) for number, own in enumerate(split)]
    best = [max(found[number] for number in np.flatnonzero(world.places == place)) for place in range(N_PLACES)]
    scores = np.array([cosine for cosine, _ in best])
    candidates = np.argsort(-scores)[:n_candidates]
    fused, start = np.zeros(n_candidates), 1
    for side, share in zip(SIDES[configuration], SHARES[configuration], strict=True):
        part = slice(start, start + (ROWS - side + 1) * (COLUMNS - side + 1))
        start = part.stop
        raw = [slow_score(configuration, query[part], split[best[place][1]][part], side) for place in candidates]
        fused += share * zscore(raw)
    scores[candidates] = 2 + math.sqrt(n_candidates - 1) + fused
    return scores


@pytest.mark.parametrize(("configuration", "n_candidates"), [("performance", 3), ("speed", 100), ("storage", N_PLACES)])
def test_scores_are_those_of_direct_loops(configuration, n_candidates, monkeypatch):
    world = made_up(configuration)
    monkeypatch.setattr(PatchNetVLAD, "encode", lambda _, images: world.codes[[image[0, 0, 0] for image in images]])
    method = made(n_components=COMPONENTS, configuration=configuration, candidates=n_candidates)
    scores = method.fit(world.references, world.places).query(world.queries)
    n_candidates = min(n_candidates, N_PLACES)
    wanted = np.stack([slow_scores(world, code, configuration, n_candidates) for code in world.codes[-3:]])
    np.testing.assert_allclose(scores, wanted, atol=1e-4)
    assert scores.argmax(1).tolist() == [2, 5, 0]
    assert np.count_nonzero(scores >= 2, axis=1).tolist() == [n_candidates] * 3


@pytest.mark.parametrize(("patches", "needed"), [("float32", r"46\.3 GB"), ("float16", r"23\.2 GB")])
def test_patches_that_do_not_fit_into_memory_are_refused_before_any_is_made(patches, needed, monkeypatch):
    monkeypatch.setattr(patch_netvlad.psutil, "virtual_memory", lambda: SimpleNamespace(available=3e9))
    method = made(n_components=4096, height=480, width=640, patches=patches)
    images = Images(lambda _: pytest.fail("an image was read"), ["x"] * 1000)
    with pytest.raises(BadInput, match=rf"{needed} .*method\.configuration=storage"):
        method.fit(images, np.arange(1000))
