"""Patch-NetVLAD: patches by direct loops in float64, matching and geometry on worked examples, and what it costs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import backbones_oracle as oracle
import cv2
import numpy as np
import pytest
import torch
from PIL import Image as PillowImage
from published_networks import PublishedNetwork
from torch import Tensor, nn
from torch.nn import functional

from vprbench.api.images import Images
from vprbench.api.method import held_together
from vprbench.api.weights import Weights
from vprbench.errors import BadInput, NotFittedError
from vprbench.methods import netvlad, patch_netvlad
from vprbench.methods.parts.patch_geometry import centres, inliers, mutual, score
from vprbench.methods.parts.patch_network import PatchNetwork
from vprbench.methods.patch_netvlad import PatchNetVLAD, above_cosines
from vprbench.plugins import conformance

SIDES = {"performance": (2, 5, 8), "speed": (5,), "storage": (5,)}
SHARES = {"performance": (0.45, 0.15, 0.4), "speed": (1.0,), "storage": (1.0,)}

Tensors = dict[str, Tensor]


def drawn(clusters: int = 3, components: int = 10, encoder: Tensors | None = None) -> Tensors:
    generator = torch.Generator().manual_seed(5)
    shape = (components, clusters * 512, 1, 1)
    return {
        **(encoder or oracle.vgg16_checkpoint(generator, "encoder.")),
        "pool.centroids": torch.randn(clusters, 512, generator=generator) / 512**0.5,
        "pool.conv.weight": 4 * torch.randn(clusters, 512, 1, 1, generator=generator),
        "WPCA.0.weight": torch.randn(shape, generator=generator, dtype=torch.float64),
        "WPCA.0.bias": 0.3 * torch.randn(components, generator=generator, dtype=torch.float64),
    }


def written(path: Path, tensors: Tensors) -> Path:
    torch.save({"epoch": 9, "num_pcs": len(tensors["WPCA.0.bias"]), "state_dict": tensors}, path)
    return path


def made(path: Path | str = "none", n_components: int = 10, **arguments: Any) -> PatchNetVLAD:
    arguments = {"components": dict.fromkeys(SIDES, n_components), "height": 144, "width": 160, **arguments}
    return PatchNetVLAD(weights=Weights("x", "", "", path=str(path)), **arguments)


def picture(height: int, width: int, seed: int = 0) -> np.ndarray:
    generator = np.random.default_rng(seed)
    coarse = cv2.resize(generator.integers(0, 256, (6, 7, 3), dtype=np.uint8), (width, height))
    return np.clip(coarse + generator.normal(0, 30, coarse.shape), 0, 255).astype(np.uint8)


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def described(tensors: Tensors, residuals: Tensor) -> np.ndarray:
    """A sum of residuals (clusters, channels) normalised, flattened with the channel fastest, and whitened."""
    vector = functional.normalize(functional.normalize(residuals, dim=1).flatten(), dim=0)
    vector = tensors["WPCA.0.weight"].double().flatten(1) @ vector + tensors["WPCA.0.bias"].double()
    return functional.normalize(vector, dim=0).numpy()


def expected(tensors: Tensors, features: Tensor, sides: Sequence[int]) -> np.ndarray:
    """Descriptors of an image and of its patches, from features (channels, h, w), patch by patch."""
    local = functional.normalize(features, dim=0)
    _, height, width = local.shape
    residuals = torch.zeros(height, width, len(tensors["pool.centroids"]), 512, dtype=torch.float64)
    for y in range(height):
        for x in range(width):
            scores = tensors["pool.conv.weight"].double()[:, :, 0, 0] @ local[:, y, x]
            shares = torch.softmax(scores, dim=0)
            residuals[y, x] = shares[:, None] * (local[:, y, x] - tensors["pool.centroids"].double())
    found = [described(tensors, residuals.sum((0, 1)))]
    for side in sides:
        for y in range(height - side + 1):
            row = [residuals[y : y + side, x : x + side] for x in range(width - side + 1)]
            found += [described(tensors, patch.sum((0, 1)) / side**2) for patch in row]
    return np.stack(found)


def described_slowly(tensors: Tensors, images: Sequence[np.ndarray]) -> np.ndarray:
    """The codes of images, from all features of each."""
    codes = []
    for image in images:
        seen = np.asarray(PillowImage.fromarray(image).resize((160, 144), PillowImage.Resampling.BILINEAR))
        features = oracle.vgg16(tensors, "encoder.", oracle.imagenet(seen), 28)[0]
        assert features.shape == (512, 9, 10)
        codes.append(unit(expected(tensors, features, (2, 5, 8)).ravel()))
    return np.stack(codes)


NETWORK = PublishedNetwork(
    "patch_netvlad",
    drawn,
    [picture(150, 170), picture(90, 90, 1)],
    10 * (1 + 8 * 9 + 5 * 6 + 2 * 3),
    described_slowly,
    written,
    arguments={"components": dict.fromkeys(SIDES, 10), "height": 144, "width": 160},
    missing=["encoder.28.bias", "pool.centroids", "WPCA.0.weight"],
    unexpected=["pool.conv.bias"],
    misshapen={"encoder.28.bias": (9,)},
    alike_in_half=0.95,
    tolerance=1e-4,
    contract=None,  # checked with a network that is shallow
)


@pytest.mark.parametrize(
    "check", [pytest.param(check, id=name) for name, check in NETWORK.checks() if name != "contract"]
)
def test_it_is_the_published_network(check, folder: Path) -> None:
    check(folder)


def test_a_file_of_other_components_is_refused_with_the_argument_that_it_wants(folder: Path) -> None:
    path = NETWORK.file(folder)
    refusal = NETWORK.refusal(path, components={"speed": 512}, configuration="speed")
    assert "method.components.speed=10" in refusal


@pytest.fixture
def file(folder: Path) -> Path:
    return NETWORK.file(folder)


@pytest.fixture
def code(folder: Path) -> np.ndarray:
    """The descriptors of an image and its patches, for all patch sizes, unit vectors."""
    return unit(NETWORK.codes(folder)[0].reshape(-1, 10))


@pytest.fixture
def shallow(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A file of a network with one convolution in VGG16's place, which that is replaced by."""
    monkeypatch.setattr(netvlad, "vgg16_features", lambda _: nn.Sequential(nn.Conv2d(3, 512, 16, stride=16)))
    generator = torch.Generator().manual_seed(0)
    weight = torch.randn(512, 3, 16, 16, generator=generator) / 16
    return written(
        tmp_path / "x.pth.tar", drawn(2, 24, {"encoder.0.weight": weight, "encoder.0.bias": torch.zeros(512)})
    )


def as_published(tensors: Tensors, features: Tensor, side: int) -> np.ndarray:
    """Descriptors of patches by the public code's steps: an integral image in float32, and its corners."""
    local = functional.normalize(features.float(), dim=0)
    shares = torch.softmax(torch.einsum("kd,dhw->khw", tensors["pool.conv.weight"][:, :, 0, 0], local), dim=0)
    residuals = shares[:, None] * (local - tensors["pool.centroids"][:, :, None, None])
    integral = functional.pad(residuals.cumsum(3).cumsum(2), (1, 0, 1, 0))
    near, far = slice(None, -side), slice(side, None)
    sums = integral[..., far, far] + integral[..., near, near] - integral[..., near, far] - integral[..., far, near]
    flat = sums.flatten(2).permute(2, 0, 1)
    return np.stack([described(tensors, patch.double()) for patch in flat])


def test_cancellation_as_published_is_had_on_request(tmp_path: Path) -> None:
    """Most clusters get hardly a share of most local descriptors: what an integral image leaves of it is rounding."""
    tensors = drawn()
    tensors["pool.conv.weight"] *= 40
    path, image = written(tmp_path / "x.pth.tar", tensors), picture(144, 160)
    features = oracle.vgg16(tensors, "encoder.", oracle.imagenet(image), 28)[0]
    exact = expected(tensors, features, (5,))[1:]

    def cosines(precision: str) -> np.ndarray:
        method = made(path, configuration="speed", precision=precision)
        return (unit(method.encode(Images.from_arrays([image])).reshape(-1, 10))[1:] * exact).sum(1)

    assert cosines("float32").min() > 0.99999
    spoilt = cosines("float32_as_published") < 0.97
    assert spoilt.any()
    np.testing.assert_array_equal(spoilt, (as_published(tensors, features, 5) * exact).sum(1) < 0.97)


def test_a_configuration_of_one_size_has_those_patches_alone(code: np.ndarray, file: Path) -> None:
    fewer = made(file, configuration="speed").encode(Images.from_arrays([picture(150, 170)])).reshape(-1, 10)
    np.testing.assert_allclose(unit(fewer), np.concatenate([code[:1], code[73:103]]), atol=1e-5)


@pytest.mark.parametrize(("side", "patches"), [(2, 1131), (5, 936), (8, 759)])
def test_a_published_size_has_the_published_number_of_patches(side: int, patches: int) -> None:
    network = PatchNetwork(1, 2, (side,))
    network.encoder = nn.Sequential(nn.Conv2d(3, 512, 16, stride=16))
    with torch.no_grad():
        for values in network.parameters():
            values.normal_()
        assert network(torch.rand(1, 3, 480, 640)).shape == (1, 2 * (1 + patches))


def test_only_patches_that_are_nearest_to_one_another_are_pairs() -> None:
    generator = np.random.default_rng(0)
    query, reference = unit(generator.standard_normal((2, 40, 3)))
    distances = np.linalg.norm(query[:, None] - reference, axis=2)
    wanted = [
        (q, r) for r in range(40) for q in range(40) if distances[q].argmin() == r and distances[:, r].argmin() == q
    ]
    assert 3 < len(wanted) < 40
    pairs = mutual((query @ reference.T).argmax(0), (query @ reference.T).argmax(1))
    assert list(zip(*pairs, strict=True)) == wanted


FOUR, SEVEN = [0, 4, 11, 13], [0, 2, 4, 6, 9, 11, 13]
ONE_STEP = [0, 1, 5, 6]


@pytest.mark.parametrize(
    ("geometry", "query", "reference", "wanted"),
    [
        ("homography", [], [], 0),
        ("homography", FOUR[:3], FOUR[:3], 0),  # a homography takes four pairs
        ("homography", FOUR, FOUR, 4 / 15),  # the share of patches that are inliers
        ("homography", SEVEN, SEVEN, 7 / 15),
        ("displacement", [], [], 0),
        ("displacement", [6], [13], (4**2 + 2**2) / 15),  # its own mean: no residual
        ("displacement", [0, 6], [2, 6], 2 * (3**2 + 2**2) / 15),  # (2, 0) and (0, 0), their mean (1, 0)
        ("displacement", ONE_STEP, [1, 2, 6, 7], 4 * (4**2 + 2**2) / 15),  # all one to the right
    ],
)
def test_pairs_score_what_is_computed_by_hand(geometry: Any, query: list[int], reference: list[int], wanted) -> None:
    pairs = np.array(query, np.int64), np.array(reference, np.int64)
    assert score(geometry, cells(3, 5), 2, pairs) == pytest.approx(wanted)


def cells(rows: int, columns: int) -> np.ndarray:
    return np.array([(x, y) for y in range(rows) for x in range(columns)])


def slow_displacement_score(pairs: Sequence[tuple[int, int]], rows: int, columns: int) -> float:
    grid = cells(rows, columns)
    mean = [sum(grid[r][axis] - grid[q][axis] for q, r in pairs) / len(pairs) for axis in (0, 1)]
    total = 0.0
    for q, r in pairs:
        for axis, most in ((0, columns - 1), (1, rows - 1)):
            total += (most - abs(grid[r][axis] - grid[q][axis] - mean[axis])) ** 2
    return total / (rows * columns)


def test_the_displacement_score_is_that_of_direct_loops() -> None:
    pairs = [(0, 6), (3, 4), (11, 2), (7, 13), (1, 8), (12, 5)]
    found = score("displacement", cells(3, 5), 5, (np.array([q for q, _ in pairs]), np.array([r for _, r in pairs])))
    assert found == pytest.approx(slow_displacement_score(pairs, 3, 5))


@pytest.mark.parametrize("side", [2, 5, 8])
def test_a_patch_stands_in_the_middle_of_what_its_corners_see(side: int) -> None:
    for x, y in [(0, 0), (3, 0), (2, 7)]:
        seen = [(16 * cell - 90, 16 * cell - 90 + 195) for cell in (x, x + side - 1, y, y + side - 1)]
        middle = [int((seen[0][0] + seen[1][1]) / 2), int((seen[2][0] + seen[3][1]) / 2)]
        assert centres(np.array([[x, y]]), side).tolist() == [middle]


def points(n: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform((0, 0), (640, 480), (n, 2))


def moved(reference: np.ndarray, homography: np.ndarray) -> np.ndarray:
    ahead = np.column_stack([reference, np.ones(len(reference))]) @ homography.T
    return ahead[:, :2] / ahead[:, 2:]


HOMOGRAPHY = np.array([[1.1, 0.1, -20], [-0.05, 0.9, 30], [1e-4, -2e-4, 1]])


def test_the_tolerance_of_24_pixels_is_one_in_the_query_image() -> None:
    reference = points(40)
    query = 4 * reference
    query[::4] += 90 * unit(np.random.default_rng(1).standard_normal((10, 2)))  # 22.5 pixels in the reference
    assert inliers(query.astype(np.float32), reference.astype(np.float32)) == 30


@pytest.mark.parametrize(("off", "counted"), [(18, 41), (40, 40)])
def test_a_point_may_be_a_little_off(off: float, counted: int) -> None:
    reference = points(41)
    query = reference.copy()
    query[7, 0] += off
    assert inliers(query.astype(np.float32), reference.astype(np.float32)) == counted


def test_points_on_one_spot_are_no_error() -> None:
    spot = np.full((6, 2), 50, np.float32)
    assert 0 <= inliers(spot, spot) <= 6


def test_the_inliers_do_not_depend_on_what_was_asked_before() -> None:
    reference, query = (points(60, seed).astype(np.float32) for seed in (2, 3))
    counts = set()
    for seed in range(5):
        cv2.setRNGSeed(seed)
        counts.add(inliers(query, reference))
    assert len(counts) == 1


LOWEST = np.full(100, 1 / math.sqrt(99))
LOWEST[3] = -math.sqrt(99)  # the standard scores if one of 100 differs


@pytest.mark.parametrize(
    ("agreement", "cosines"),
    [(np.array([0.5, -1.7, 1.2, 0.0]), [0.1, 0.99, -0.3, 0.2]), (LOWEST, np.zeros(100)), (np.zeros(1), [0.3])],
)
def test_candidates_score_above_every_cosine_in_the_order_of_their_agreement(agreement: np.ndarray, cosines) -> None:
    scores = above_cosines(agreement, np.array(cosines, np.float32))
    np.testing.assert_allclose(scores, agreement + 2 + math.sqrt(len(agreement) - 1), rtol=1e-6, atol=1e-5)
    assert scores.min() > 1.99999
    assert scores.dtype == np.float32


def test_of_equal_agreement_the_higher_cosine_comes_first() -> None:
    scores = above_cosines(np.zeros(4), np.array([0.3, 0.9, 0.3, 0.5], np.float32))
    assert scores[1] > scores[3] > scores[0] == scores[2]
    np.testing.assert_allclose(scores, 2 + math.sqrt(3), rtol=1e-6)


N_PLACES, ROWS, COLUMNS, COMPONENTS = 7, 9, 10, 12


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Made-up codes: two reference images a place, of which the patches are moved and noisy, and a query."""
    generator = np.random.default_rng(4)
    n_patches = [(ROWS - side + 1) * (COLUMNS - side + 1) for side in SIDES["performance"]]
    base = generator.standard_normal((N_PLACES, 1 + sum(n_patches), COMPONENTS))
    places = np.repeat(np.arange(N_PLACES), 2)[generator.permutation(2 * N_PLACES)]
    noise = generator.uniform(0.2, 0.9, (2 * N_PLACES, 1, 1))
    references = base[places] + noise * generator.standard_normal((2 * N_PLACES, *base.shape[1:]))
    queries = base[[2, 5, 0]] + 0.7 * generator.standard_normal((3, *base.shape[1:]))
    codes = unit(unit(np.concatenate([references, queries])).reshape(2 * N_PLACES + 3, -1)).astype(np.float32)
    monkeypatch.setattr(PatchNetVLAD, "encode", lambda _, images: codes[[image[0, 0, 0] for image in images]])
    images = Images.from_arrays([np.full((1, 1, 3), i, np.uint8) for i in range(len(codes))])
    return SimpleNamespace(
        references=images[: 2 * N_PLACES], places=places, queries=images[2 * N_PLACES :], codes=codes
    )


def slow_scores(world: SimpleNamespace, code: np.ndarray, configuration: str, n_candidates: int) -> np.ndarray:
    """A query's scores, place by place, pair by pair."""
    split = [unit(one.reshape(-1, COMPONENTS).astype(np.float64)) for one in world.codes]
    query = unit(code.reshape(-1, COMPONENTS).astype(np.float64))
    best = {}
    for image, place in enumerate(world.places.tolist()):
        cosine = float(split[image][0] @ query[0])
        best[place] = max(best.get(place, (-2.0, -1)), (cosine, image))
    scores = np.array([best[place][0] for place in range(N_PLACES)])
    candidates = sorted(range(N_PLACES), key=lambda place: -scores[place])[:n_candidates]
    fused = np.zeros(n_candidates)
    start = 1
    for side, share in zip(SIDES[configuration], SHARES[configuration], strict=True):
        rows, columns = ROWS - side + 1, COLUMNS - side + 1
        part = slice(start, start + rows * columns)
        start = part.stop
        raw = []
        for place in candidates:
            other = split[best[place][1]][part]
            distances = np.linalg.norm(query[part][:, None] - other, axis=2)
            pairs = [
                (q, r) for r in range(len(other)) for q in [int(distances[:, r].argmin())] if distances[q].argmin() == r
            ]
            if not pairs or (configuration == "performance" and len(pairs) < 4):
                raw.append(0.0)
            elif configuration == "performance":
                middle = 16 * cells(rows, columns) + 8 * (side - 1) + 7.0
                ends = [middle[[pair[end] for pair in pairs]] for end in (1, 0)]
                _, mask = cv2.findHomography(*ends, cv2.RANSAC, 24)
                raw.append(-int(mask.sum()) / (rows * columns))
            else:
                raw.append(-slow_displacement_score(pairs, rows, columns))
        fused += share * (np.array(raw) - np.mean(raw)) / np.std(raw)
    scores[candidates] = 2 + math.sqrt(n_candidates - 1) - fused  # the source's scores are the lower the more alike
    return scores


def world_of(world: SimpleNamespace, configuration: str) -> SimpleNamespace:
    """The same codes with the patches of one configuration alone."""
    if configuration == "performance":
        return world
    first = 1 + (ROWS - 1) * (COLUMNS - 1)
    n_patches = (ROWS - 4) * (COLUMNS - 4)
    split = world.codes.reshape(len(world.codes), -1, COMPONENTS)
    kept = unit(np.concatenate([split[:, :1], split[:, first : first + n_patches]], axis=1).reshape(len(split), -1))
    return SimpleNamespace(**vars(world) | {"codes": kept})


def fitted(world: SimpleNamespace, monkeypatch: pytest.MonkeyPatch, **arguments: Any) -> PatchNetVLAD:
    codes = world.codes
    monkeypatch.setattr(PatchNetVLAD, "encode", lambda _, images: codes[[image[0, 0, 0] for image in images]])
    return made(n_components=COMPONENTS, **arguments).fit(world.references, world.places)


@pytest.mark.parametrize("n_candidates", [3, N_PLACES, 100])
@pytest.mark.parametrize("configuration", SIDES)
def test_scores_are_those_of_direct_loops(configuration: str, n_candidates: int, world, monkeypatch) -> None:
    world = world_of(world, configuration)
    method = fitted(world, monkeypatch, configuration=configuration, candidates=n_candidates)
    scores = method.query(world.queries)
    n_candidates = min(n_candidates, N_PLACES)
    wanted = np.stack([slow_scores(world, code, configuration, n_candidates) for code in world.codes[-3:]])
    np.testing.assert_allclose(scores, wanted, atol=1e-4)
    assert scores.argmax(1).tolist() == [2, 5, 0]
    assert np.count_nonzero(scores >= 2, axis=1).tolist() == [n_candidates] * 3


def test_references_in_float16_give_almost_the_same_scores(world, monkeypatch) -> None:
    scores, rounded = (fitted(world, monkeypatch, patches=kind).query(world.queries) for kind in ("float32", "float16"))
    np.testing.assert_allclose(rounded, scores, atol=0.3)
    assert rounded.argmax(1).tolist() == scores.argmax(1).tolist()


def cosines(world: SimpleNamespace) -> np.ndarray:
    """Of each query with the best image of each place."""
    whole = unit(world.codes.reshape(len(world.codes), -1, COMPONENTS)[:, 0])
    similarity = whole[-3:] @ whole[:-3].T
    return np.stack([similarity[:, world.places == place].max(1) for place in range(N_PLACES)], axis=1)


@pytest.mark.parametrize("constant", [0.0, 0.1 + 0.2])
def test_candidates_of_equal_scores_keep_the_order_of_their_cosines(constant: float, world, monkeypatch) -> None:
    method = fitted(world, monkeypatch)
    monkeypatch.setattr(patch_netvlad, "score", lambda *_: constant)
    scores = method.query(world.queries)
    np.testing.assert_allclose(scores, 2 + math.sqrt(N_PLACES - 1), rtol=1e-5)
    np.testing.assert_array_equal(np.argsort(scores), np.argsort(cosines(world)))


def test_float16_holds_for_descriptors_from_elsewhere_too(world, monkeypatch) -> None:
    method = made(n_components=COMPONENTS, patches="float16").fit_descriptors(world.codes[:-3], world.places)
    assert method._map.codes.dtype == np.float16
    rounded = fitted(world, monkeypatch, patches="float16").query(world.queries)
    np.testing.assert_array_equal(method.match(world.codes[-3:]), rounded)


def test_candidates_are_taken_from_what_an_approximate_index_retrieves(world, monkeypatch) -> None:
    method = fitted(world, monkeypatch, index="hnsw", neighbours=3)
    scores = method.query(world.queries)
    shown = np.isfinite(scores)
    assert (scores[shown] >= 2).all()
    assert (shown.sum(1) <= 3).all()
    assert shown[np.arange(3), cosines(world).argmax(1)].all()
    assert (scores[~shown] == -np.inf).all()


def test_an_index_can_be_audited(world, monkeypatch) -> None:
    audit = fitted(world, monkeypatch, index="hnsw").audit(world.codes[-3:])
    assert audit.recall_at_1 == audit.recall_at_10 == 1


def test_descriptors_from_elsewhere_give_the_same_map_and_are_not_copied(world, monkeypatch) -> None:
    method, references = made(n_components=COMPONENTS), world.codes[:-3]
    world.codes.flags.writeable = references.flags.writeable = False  # as what is read from disk
    scores = method.fit_descriptors(references, world.places).match(world.codes[-3:])
    np.testing.assert_array_equal(scores, fitted(world, monkeypatch).query(world.queries))
    assert np.shares_memory(method._map.codes, references)


@pytest.mark.parametrize(("configuration", "kept"), [("performance", False), ("speed", False), ("storage", True)])
def test_only_small_descriptors_are_kept_on_disk(configuration: str, kept: bool) -> None:
    assert made(configuration=configuration).keeps_descriptors() is kept


def test_match_before_fit_is_refused() -> None:
    with pytest.raises(NotFittedError, match="PatchNetVLAD has no map yet"):
        made().match(np.zeros((1, 10), np.float32))


@pytest.mark.parametrize(
    ("call", "patches", "needed", "advice"),
    [
        ("fit", "float32", r"46\.3 GB", r"method\.patches=float16"),
        ("fit", "float16", r"23\.2 GB", "method.configuration=storage"),
        ("encode", "float32", r"46\.3 GB", "method.configuration=storage"),
    ],
)
def test_patches_that_do_not_fit_into_memory_are_refused_before_any_is_made(
    call: str, patches: str, needed: str, advice: str, monkeypatch
) -> None:
    monkeypatch.setattr(patch_netvlad.psutil, "virtual_memory", lambda: SimpleNamespace(available=3e9))
    method = made(n_components=4096, height=480, width=640, patches=patches)
    images = Images(lambda _: pytest.fail("an image was read"), ["x"] * 1000)
    with pytest.raises(BadInput, match=rf"{needed} .*{advice}"):
        method.fit(images, np.arange(1000)) if call == "fit" else method.encode(images)


@pytest.mark.parametrize("configuration", SIDES)
def test_the_bytes_of_a_code_are_those_that_encode_gives(configuration: str, file: Path) -> None:
    method = made(file, configuration=configuration)
    (code,) = method.encode(Images.from_arrays([picture(150, 170)]))
    assert method.code_bytes == code.nbytes


def test_a_gibibyte_holds_23_codes_of_the_published_size() -> None:
    method = made(n_components=4096, height=480, width=640)
    assert method.code_bytes == 4 * 4096 * (1 + 1131 + 936 + 759)
    assert held_together(method, 128) == 23


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ({"height": None}, "method.height=None, method.width=160: give both"),
        ({"width": 127}, "need at least 128x128 pixels"),
        ({"height": 79, "configuration": "speed"}, "configuration=speed need at least 80x80 pixels"),
        ({"candidates": 0}, "method.candidates=0: give at least 1 place"),
        ({"components": {"speed": 512}}, "method.components=.*performance"),
    ],
)
def test_arguments_that_do_not_fit_are_named(arguments: dict[str, Any], complaint: str) -> None:
    with pytest.raises(BadInput, match=complaint):
        made(**arguments).encode(Images.from_arrays([picture(32, 32)]))


@pytest.mark.parametrize("configuration", ["performance", "storage"])
def test_the_contract_is_kept(configuration: str, shallow: Path) -> None:
    config = {
        "_target_": "vprbench.methods.patch_netvlad.PatchNetVLAD",
        "configuration": configuration,
        "components": dict.fromkeys(SIDES, 24),
        "candidates": 4,
        "weights": {"file": "x", "licence": "", "trained_on": "", "path": str(shallow)},
        "height": 144,
        "width": 144,
    }
    assert [str(result) for result in conformance.check(config) if result.state == "broken"] == []
