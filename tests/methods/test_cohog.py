"""CoHOG against a slow float64 implementation, examples by hand and the results that VPR-Bench stored."""

import cohog_oracle as oracle
import cv2
import numpy as np
import pytest
import torch
from checkout import SHARED

from vprbench.api.images import Images
from vprbench.errors import BadInput
from vprbench.methods import cohog
from vprbench.methods.cohog import (
    CoHOG,
    from_tiles,
    gradient_histograms,
    in_tiles,
    local_entropy,
    mean_best_cosine,
    mean_best_cosine_in_tiles,
    region_vectors,
)

CORRIDOR, SOME = SHARED / "data" / "corridor", slice(None, None, 3)  # of the queries
SMALL = {"size": 64, "cell": 8, "entropy_size": 20, "entropy_radius": 3, "entropy_threshold": 0.45}


def scene(seed, height=31, width=47):
    """A smooth picture of noise with a flat and a nearly flat corner."""
    generator = np.random.default_rng(seed)
    coarse = generator.integers(0, 256, (6, 8, 3), dtype=np.uint8)
    image = np.asarray(cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC), np.uint8).copy()
    image[: height // 2, : width // 3] = 77
    image[height // 2 :, : width // 3] = 120 + generator.integers(0, 2, (1, 1, 3), dtype=np.uint8)
    return image


def resized(image, size):
    return cv2.resize(image, (size, size), interpolation=cv2.INTER_LINEAR)


def split(codes):
    return codes[..., :-1], codes[..., -1]


def fitted_to(references, places=None, size=48):
    """A map of given regions: (n_references, 4 regions, 32)."""
    references = np.asarray(references, np.float32)
    places = np.arange(len(references)) if places is None else np.asarray(places)
    return CoHOG(size=size).restore({"references": references, "places": places})


def unit(*numbers):
    vector = np.zeros(32, np.float32)
    vector[list(numbers)] = 1 / np.sqrt(len(numbers))
    return vector


ZERO = np.zeros(32, np.float32)


def code(regions, good):
    return np.concatenate([np.stack(regions), np.array(good, np.float32)[:, None]], axis=1)[None]


# Gradients. Where the root rises by 1 a pixel the kernel of 5 makes 2 * (2 * 1 + 1 * 2) * (1 + 4 + 6 + 4 + 1) = 128.


TWO_DOWN, TWO_RIGHT = ((np.degrees(np.arctan2(2, 1)) - 45) / 45, (360 - np.degrees(np.arctan2(1, 2)) - 315) / 45)


def root_image(rise_down, rise_right, height, width):
    """Levels whose roots rise evenly: squares of whole numbers; and the largest root."""
    root = rise_down * np.arange(height)[:, None] + rise_right * np.arange(width)[None, :]
    return (root**2).astype(np.uint8), int(root.max())


@pytest.mark.parametrize(
    ("down", "right", "turned", "votes"),
    [
        (0, 1, False, {0: 64}),  # to the right 0 degrees, half the gradient
        (1, 0, False, {2: 64}),  # downwards 90 degrees
        (1, 1, False, {1: 128}),  # half the sum; a length would give 181
        (1, 1, True, {}),  # to the upper right
        (2, 1, False, {1: 192 * (1 - TWO_DOWN), 2: 192 * TWO_DOWN}),  # 63.4 degrees
        (1, 2, True, {7: 64 * (1 - TWO_RIGHT), 0: 64 * TWO_RIGHT}),  # 333.4 degrees
    ],
)
def test_an_even_rise_votes_for_its_angle_and_the_next(down, right, turned, votes):
    levels, peak = root_image(down, right, 6, 6)
    found = gradient_histograms(levels[::-1].copy() if turned else levels, cell=1, bins=8, sobel=5)[3, 3]
    assert found == pytest.approx([votes.get(number, 0) / peak for number in range(8)], abs=1e-4)


@pytest.mark.parametrize(("turns", "right"), [(0, 0), (1, 6), (2, 4), (3, 2)])
def test_an_edge_votes_for_the_direction_in_which_it_brightens(turns, right):
    edge = np.zeros((16, 16), np.uint8)
    edge[:, 8:] = 255
    votes = gradient_histograms(np.rot90(edge, turns).copy(), cell=16, bins=8, sobel=5)[0, 0]
    assert votes[right] == pytest.approx(16 * 0.5 * 16 * (1 + 3 + 3 + 1), rel=1e-5)
    assert votes.sum() == votes[right]


@pytest.mark.parametrize("level", range(0, 255, 7))
def test_a_flat_area_has_no_gradient_beside_any_brighter_pixel(level):
    levels = np.full((16, 32), level, np.uint8)
    levels[:, 31] = 255
    assert gradient_histograms(levels, cell=8, bins=8, sobel=5)[:, :3].max() == 0


# Regions.


def test_a_region_lines_up_its_cells_row_by_row():
    cells = np.arange(1.0, 13.0).reshape(2, 3, 2)
    regions = region_vectors(cells, 2)
    wanted = np.array([[1, 2, 3, 4, 7, 8, 9, 10], [3, 4, 5, 6, 9, 10, 11, 12]])
    assert regions == pytest.approx(wanted / np.linalg.norm(wanted, axis=1, keepdims=True))


def test_a_region_without_a_gradient_stays_zero():
    regions, _ = split(CoHOG(**SMALL).encode(Images.from_arrays([np.full((40, 30, 3), 77, np.uint8)])))
    assert not regions.any()


def test_the_published_size_gives_961_regions_of_32_numbers_and_their_goodness():
    codes = CoHOG().encode(Images.from_arrays([scene(0)]))
    lengths = np.linalg.norm(codes[0, :, :32], axis=1)
    assert codes.shape == (1, 961, 33)
    assert codes.dtype == np.float32
    assert lengths[lengths > 0] == pytest.approx(1, abs=1e-5)


# Entropy.


def test_the_entropy_of_different_levels_is_the_logarithm_of_the_pixels_inside():
    bits = local_entropy(np.arange(9, dtype=np.uint8).reshape(3, 3), 1)
    assert bits == pytest.approx(np.log2([[3, 4, 3], [4, 5, 4], [3, 4, 3]]))


def test_the_entropy_counts_levels_that_come_again():
    bits = local_entropy(np.array([[0, 8, 0], [8, 8, 5], [0, 255, 0]], np.uint8), 1)[1, 1]
    assert bits == pytest.approx(3 / 5 * np.log2(5 / 3) + 2 * (1 / 5) * np.log2(5))


def test_a_disk_of_radius_5_has_81_pixels():
    levels = np.arange(121, dtype=np.uint8).reshape(11, 11)
    assert local_entropy(levels, 5)[5, 5] == pytest.approx(np.log2(81))


# Scores.


@pytest.mark.parametrize(
    ("reference", "query", "good", "wanted"),
    [
        ([unit(0), unit(0), unit(2), ZERO], [unit(0), unit(1), unit(2), unit(0, 5)], [1, 1, 0, 1], (1 + 0.5**0.5) / 3),
        ([unit(0)] * 4, [unit(0), ZERO, ZERO, ZERO], [1, 1, 0, 0], 1 / 2),  # one without a gradient counts
        ([unit(0)] * 4, [unit(0)] * 4, [0] * 4, 0),  # none is good
    ],
)
def test_a_score_is_the_mean_over_the_good_regions_of_the_best_region(reference, query, good, wanted):
    assert fitted_to([reference]).match(code(query, good))[0] == pytest.approx([wanted])


def test_the_goodness_of_a_reference_does_not_count():
    images = Images.from_arrays([scene(0), scene(1)])
    scores = [
        CoHOG(**{**SMALL, "entropy_threshold": threshold})
        .fit(images, np.arange(2))
        .match(CoHOG(**SMALL).encode(images))
        for threshold in (0.0, 1.0)
    ]
    assert np.array_equal(*scores)


@pytest.mark.parametrize("n_threads", [2, 3, 8])
def test_any_number_of_threads_gives_exactly_the_same(monkeypatch, n_threads):
    images = Images.from_arrays([scene(seed) for seed in range(5)])
    method = CoHOG(**SMALL).fit(images, np.arange(5))
    scores = []
    for number in (1, n_threads):
        monkeypatch.setattr(torch, "get_num_threads", lambda number=number: number)
        scores.append(method.query(images))
    assert np.array_equal(*scores)


# Against the slow implementation.


def judged(images, size, cell, entropy_size, entropy_radius):
    """Regions and their mean entropy."""
    greys = [resized(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), size) for image in images]
    regions = [oracle.regions(oracle.histograms(grey, cell, 8)) for grey in greys]
    entropies = [oracle.region_entropy(resized(grey, entropy_size), entropy_radius, size, cell) for grey in greys]
    return np.stack(regions), np.stack(entropies)


@pytest.fixture(scope="module")
def small_world():
    images = [scene(0), scene(1, 64, 64), scene(2, 101, 33), np.zeros((7, 9, 3), np.uint8)]
    regions, entropies = judged(images, **{name: SMALL[name] for name in SMALL if name != "entropy_threshold"})
    return Images.from_arrays(images), regions, entropies


def test_regions_equal_the_slow_implementation(small_world):
    images, regions, _ = small_world
    assert split(CoHOG(**SMALL).encode(images))[0] == pytest.approx(regions, abs=1e-4)


def test_goodness_equals_the_slow_implementation(small_world):
    images, _, entropies = small_world
    good = entropies >= SMALL["entropy_threshold"]
    assert np.abs(entropies - SMALL["entropy_threshold"]).min() > 1e-6  # no region is on the threshold
    assert 0.1 < good.mean() < 0.9
    assert np.array_equal(split(CoHOG(**SMALL).encode(images))[1] == 1, good)


def test_scores_equal_the_slow_implementation(small_world):
    images, regions, entropies = small_world
    good = entropies >= SMALL["entropy_threshold"]
    wanted = [
        [oracle.score(query, chosen, other) for other in regions] for query, chosen in zip(regions, good, strict=True)
    ]
    assert CoHOG(**SMALL).fit(images, np.arange(4)).query(images) == pytest.approx(np.array(wanted), abs=1e-4)


def test_the_published_constants_equal_the_slow_implementation():
    image = scene(3, 97, 131)
    regions, entropies = judged([image], size=512, cell=16, entropy_size=100, entropy_radius=5)
    codes = CoHOG().encode(Images.from_arrays([image]))
    sure = np.abs(entropies - 0.4) > 1e-6
    assert split(codes)[0] == pytest.approx(regions, abs=1e-4)
    assert np.array_equal((split(codes)[1] == 1)[sure], (entropies >= 0.4)[sure])


def numbers(seed, n_query, n_references, n_regions, d):
    """Regions of a query and of references, and the mean best dot that a loop finds; most numbers are negative."""
    generator = np.random.default_rng(seed)
    query = generator.normal(-1, 1, (n_query, d)).astype(np.float32)
    references = generator.normal(0.5, 1, (n_references, n_regions, d)).astype(np.float32)
    wanted = [oracle.score(query, np.ones(n_query, bool), reference) for reference in references.astype(np.float64)]
    return query, references, wanted


@pytest.mark.parametrize("block_bytes", [1, 2 * 4 * 7 * 9, 1 << 30])
def test_the_best_dots_in_blocks_of_any_size_equal_a_loop(monkeypatch, block_bytes):
    monkeypatch.setattr(cohog, "_PRODUCT_BYTES", block_bytes)
    query, references, wanted = numbers(0, n_query=7, n_references=5, n_regions=9, d=8)
    found = mean_best_cosine(torch.from_numpy(query), torch.from_numpy(references))
    assert found.numpy() == pytest.approx(wanted, rel=1e-5, abs=1e-5)


@pytest.mark.parametrize("n_query", [1, 5, 6, 7, 25])
@pytest.mark.parametrize("n_regions", [1, 31, 32, 33, 100])
@pytest.mark.parametrize("d", [1, 8, 33])
def test_the_best_dots_in_tiles_equal_a_loop(n_query, n_regions, d):
    query, references, wanted = numbers(1, n_query, 3, n_regions, d)
    found = mean_best_cosine_in_tiles(query, np.stack([in_tiles(own) for own in references]))
    assert found == pytest.approx(wanted, rel=1e-5, abs=1e-5)


@pytest.mark.parametrize("n_regions", [1, 31, 32, 33, 100])
def test_regions_come_out_of_tiles_as_they_went_in(n_regions):
    _, references, _ = numbers(2, 1, 3, n_regions, 8)
    assert np.array_equal(from_tiles(np.stack([in_tiles(own) for own in references]), n_regions), references)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU that PyTorch can use")
def test_a_gpu_gives_the_scores_and_the_stored_regions_of_the_cpu():
    images = Images.from_arrays([scene(seed) for seed in range(5)])
    on_cpu, on_gpu = (CoHOG(**SMALL, device=device).fit(images, np.arange(5)) for device in ("cpu", "cuda"))
    assert on_gpu.query(images) == pytest.approx(on_cpu.query(images), abs=1e-5)
    assert np.array_equal(on_gpu.state()["references"], on_cpu.state()["references"])


# The contract beyond the conformance suite.


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ({"size": 500}, r"method\.size=500: give a multiple of method\.cell=16"),
        ({"size": 16}, "at least one region, 32 pixels"),
        ({"cell": 0}, r"method\.cell=0"),
        ({"bins": 1}, r"method\.bins=1"),
        ({"sobel": 4}, "3, 5 or 7"),
        ({"entropy_radius": -1}, r"method\.entropy_radius=-1"),
        ({"entropy_threshold": float("nan")}, "a finite number"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(arguments, complaint):
    with pytest.raises(BadInput, match=complaint):
        CoHOG(**arguments).encode(Images.from_arrays([scene(0)]))


# Real frames.


@pytest.fixture(scope="module")
def corridor():
    """Our scores of every third query and the scores that VPR-Bench (77ad30f) stored of all, each of 111 references."""
    if not CORRIDOR.is_dir():
        pytest.skip("the folder shared/ is not beside the checkout")
    references, queries = (Images.from_files(sorted((CORRIDOR / name).glob("*.jpg"))) for name in ("ref", "query"))
    with np.load(CORRIDOR / "vprbench_precomputed.npz") as stored:
        return CoHOG().fit(references, np.arange(111)).query(queries[SOME]), stored["CoHOG__similarity"]


def test_corridor_finds_as_many_as_the_stored_result_of_vprbench(corridor):
    # Stored: 69 of 111 within two frames; the same rule gives SAD 49 (0.4414). Four best matches are near-ties.
    scores, stored = corridor
    right = np.abs(stored.argmax(1) - np.arange(111)) <= 2
    assert np.count_nonzero(right) == 69
    ours = np.abs(scores.argmax(1) - np.arange(111)[SOME]) <= 2
    assert np.count_nonzero(ours) == pytest.approx(np.count_nonzero(right[SOME]), abs=2)


def test_corridor_scores_are_those_that_vprbench_stored(corridor):
    scores, stored = corridor
    stored = stored[SOME]
    difference = np.abs(scores - stored)
    assert np.median(difference) < 1e-4
    assert difference.max() < 4e-3
    # Where another reference is best, the stored scores of the two hardly differ.
    ours = stored[np.arange(len(stored)), scores.argmax(1)]
    assert np.abs(ours - stored.max(1)).max() < 4e-4
    assert np.count_nonzero(scores.argmax(1) == stored.argmax(1)) >= len(stored) - 4
