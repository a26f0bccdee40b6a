"""Random projections, FlyHash, hyperdimensional vectors, and bits of filters and edges, against their formulas."""

import numpy as np
import pytest
from described_images import drawn_images
from published_networks import unit

from vprbench.api.images import Images
from vprbench.methods.binary import mark_strongest
from vprbench.methods.flyhash import FlyHash
from vprbench.methods.hyperdimensional import HyperDimensional
from vprbench.methods.parts.filters.oriented import OrientedEdges
from vprbench.methods.random_projection import RandomProjection
from vprbench.methods.sad import SAD

FRAMES = Images.from_arrays(drawn_images(*[(40, 48)] * 12))


def contrasts(images, **size):
    return SAD(**size).encode(images).astype(float) - 127


@pytest.mark.parametrize("directions", ["gaussian", "signs", "sparse_signs"])
def test_cosines_of_random_projections_are_those_of_the_frames_but_for_what_chance_allows(directions):
    frames = unit(contrasts(FRAMES))
    for components in (256, 16384):
        method = RandomProjection(components=components, directions=directions, seed=3).fit(FRAMES, np.arange(12))
        errors = (method.query(FRAMES) - frames @ frames.T)[~np.eye(12, dtype=bool)]
        # Johnson and Lindenstrauss: the deviation of a cosine near 0 is 1 / sqrt(components).
        assert 0.5 < errors.std() * components**0.5 < 1.5


@pytest.mark.parametrize(
    ("directions", "shares"),
    [("signs", {0: 1 / 2, 2: 1 / 2}), ("sparse_signs", {0: 1 / 2, 1: 4 / 9, 2: 1 / 18}), ("gaussian", {0: 0, 2: 0})],
)
def test_directions_are_signs_sparse_signs_or_gaussian(directions, shares):
    # Of two pixels the contrasts are -90 and 90, so a component shows the difference of its two numbers.
    two = Images.from_arrays([np.array([[0, 255]], np.uint8)])
    code = RandomProjection(height=1, width=2, components=20000, directions=directions).encode(two)[0]
    magnitudes = 2 * np.abs(code) / np.abs(code).max()
    found = {size: np.mean(np.abs(magnitudes - size) < 1e-5) for size in shares}
    assert found == pytest.approx(shares, abs=0.01)
    assert abs(np.sign(code).mean()) < 0.03


def test_winners_are_the_units_with_the_largest_sums_of_centred_pixels():
    # Dasgupta et al. 2017: mean-centred inputs, summed by each unit; the largest sums above 0 win.
    method = FlyHash(units=300, summed=20, winners=15, seed=4, height=12, width=12)
    generator = np.random.default_rng(4)
    samples = [generator.choice(144, 20, replace=False) for _ in range(300)]
    codes, wanted = method.encode(FRAMES), []
    for frame in contrasts(FRAMES, height=12, width=12):
        sums = np.array([(frame - frame.mean())[own].sum() for own in samples])
        best = np.argsort(-np.round(sums, 6), kind="stable")[:15]
        wanted.append({int(unit) for unit in best if sums[unit] > 1e-6})
    assert [{*row[row >= 0].tolist()} for row in codes] == wanted
    shared = [[len({*left} & {*right} - {-1}) / 15 for right in codes.tolist()] for left in codes[:5].tolist()]
    assert method.fit(FRAMES, np.arange(12)).query(FRAMES[:5]) == pytest.approx(np.array(shared))


def slow_kernel(rows, columns, reach):
    """The similarity of every two positions: it falls evenly with the distance along each axis."""
    down, across = (np.abs(np.subtract.outer(axis.ravel(), axis.ravel())) for axis in np.mgrid[:rows, :columns])
    return np.clip(1 - down / reach, 0, None) * np.clip(1 - across / reach, 0, None)


@pytest.mark.parametrize(
    ("features", "reach", "rows", "columns"), [("patches", 0.5, 3, 5), ("patches", 3.0, 3, 5), ("oriented", 2.0, 4, 6)]
)
def test_cosines_of_bundles_are_those_of_cells_weighed_by_how_near_they_are(features, reach, rows, columns):
    method = HyperDimensional(features, height=16, width=24, components=1 << 16, reach=reach)
    if features == "patches":
        frames = contrasts(FRAMES, height=16, width=24).reshape(12, 16, 24)
        corners = [(y, x) for y in range(0, 9, 4) for x in range(0, 17, 4)]
        cells = np.array([[frame[y : y + 8, x : x + 8].ravel() for y, x in corners] for frame in frames])
    else:
        cells = OrientedEdges(16, 24, rows, columns)(FRAMES).reshape(12, rows * columns, 8)
    products = np.einsum("acp,cd,bdp->ab", cells, slow_kernel(rows, columns, reach), cells)
    expected = products / np.sqrt(np.outer(np.diag(products), np.diag(products)))
    assert method.fit(FRAMES, np.arange(12)).query(FRAMES) == pytest.approx(expected, abs=0.02)


VALUES = np.array([[[0.9, 0.1], [0.5, 0.0], [0.7, 0.3], [0.0, 0.2]]], np.float32)  # 4 cells of 2 maps


@pytest.mark.parametrize(
    ("within", "shares", "wanted"),
    [
        ("map", [0.25], [[1, 0], [0, 0], [0, 1], [0, 0]]),
        ("map", [1.0], [[1, 1], [1, 0], [1, 1], [0, 1]]),  # nothing is never strong
        ("map", [0.5, 0.25], [[1, 0], [0, 0], [1, 1], [0, 1], [1, 0], [0, 0], [0, 1], [0, 0]]),
        ("cell", [0.5], [[1, 0], [1, 0], [1, 0], [0, 1]]),
        ("cell", [0.01], [[1, 0], [1, 0], [1, 0], [0, 1]]),  # one at least
    ],
)
def test_bits_are_the_strongest_of_a_map_or_of_a_cell(within, shares, wanted):
    assert mark_strongest(VALUES, within, shares).astype(int).tolist() == [np.ravel(wanted).tolist()]
