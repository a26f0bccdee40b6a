"""The rendered railway is about as hard as real frames of Nordland, to several methods and in the same order."""

from functools import cache

import cv2
import numpy as np
import pytest
from checkout import SHARED
from seqslam_judge import PLACES, differences, evenly, recall, small_and_grey

from vprbench.api.images import Images
from vprbench.datasets.synthetic import synthetic
from vprbench.methods.cohog import CoHOG
from vprbench.methods.densevlad.method import DenseVLAD
from vprbench.methods.hog import HOG
from vprbench.methods.pca import PCA
from vprbench.methods.sad import SAD
from vprbench.methods.vprtempo.method import VPRTempo

NORDLAND = SHARED / "data" / "nordland_64x32"
needs_nordland = pytest.mark.skipif(not NORDLAND.is_dir(), reason=f"{NORDLAND} holds the real frames and is not there")

# R@1 of the real frames, winter found again in summer, published beside them (nordland_64x32/README.md).
REAL = {100: 0.41, 200: 0.355, 400: 0.29, 800: 0.2675}
# Measured on 800 of the real frames: of the right pairs, and of the most similar wrong pair of each query.
REAL_RIGHT, REAL_WRONG = 0.904, 0.842
REAL_ERRORS_WITHIN_TEN_PLACES = 0.02

each_source = pytest.mark.parametrize("source", ["railway", pytest.param("nordland", marks=needs_nordland)])


@cache
def railway(season, seed=0, sizes=(60, *REAL)):
    """Frames of the places that the subsets of these sizes need, by place."""
    traverse = synthetic(places=PLACES, references=[season], query=season, seed=seed).references
    return {place: small_and_grey(traverse[place]) for place in {p for size in sizes for p in evenly(size)}}


@cache
def nordland(season):
    names = (NORDLAND / "frames_clean_qvpr.txt").read_text().split()
    return [cv2.imread(str(NORDLAND / season / name), cv2.IMREAD_GRAYSCALE) for name in names]


def subset(source, season, count, **asked):
    frames = {"railway": railway, "nordland": nordland}[source](season, **asked)
    return np.stack([frames[place] for place in evenly(count)])


@needs_nordland
def test_the_judge_finds_on_real_frames_what_was_published_with_them():
    assert len(nordland("winter")) == len(nordland("summer")) == PLACES
    for count, expected in REAL.items():
        assert recall(subset("nordland", "winter", count), subset("nordland", "summer", count)) == pytest.approx(
            expected, abs=0.005
        )


@pytest.mark.parametrize("count", REAL)
def test_winter_is_found_again_in_summer_as_often_as_on_real_frames(count):
    found = recall(subset("railway", "winter", count), subset("railway", "summer", count))
    assert found == pytest.approx(REAL[count], abs=0.08)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_railway_of_another_seed_is_about_as_hard(seed):
    sizes = (100, 200)
    for count in sizes:
        winter, summer = (subset("railway", season, count, seed=seed, sizes=sizes) for season in ("winter", "summer"))
        assert recall(winter, summer) == pytest.approx(REAL[count], abs=0.08)


@each_source
def test_right_and_wrong_pairs_differ_as_much_as_real_ones_and_wrong_answers_lie_as_far_away(source):
    apart = differences(subset(source, "winter", 800), subset(source, "summer", 800))
    right = apart.diagonal().copy()
    off = np.abs(apart.argmin(axis=0) - np.arange(800))
    assert (off[off > 0] <= 10).mean() == pytest.approx(REAL_ERRORS_WITHIN_TEN_PLACES, abs=0.04)
    np.fill_diagonal(apart, np.inf)
    assert np.median(right) == pytest.approx(REAL_RIGHT, abs=0.03)
    assert np.median(apart.min(axis=0)) == pytest.approx(REAL_WRONG, abs=0.03)


def rates(source, count, methods):
    """R@1 of methods that know winter and are asked in summer, as on all of nordland_64x32."""
    references, queries = (
        Images.from_arrays([cv2.cvtColor(frame, cv2.COLOR_GRAY2RGB) for frame in subset(source, season, count)])
        for season in ("winter", "summer")
    )
    right = np.arange(count)
    return [(method.fit(references, right).query(queries).argmax(axis=1) == right).mean() for method in methods]


# On all 2761 real places: HOG 34.8 %, SAD 25.0, VPRTempo 19.3, PCA 18.5, CoHOG 5.1, DenseVLAD 4.7. The intervals of
# VPRTempo and PCA overlap, and so do those of CoHOG and DenseVLAD.


@each_source
def test_methods_that_need_no_weights_come_in_the_order_of_the_real_frames(source):
    hog, sad, vprtempo, pca = rates(source, 400, (HOG(), SAD(), VPRTempo(max_module=400), PCA()))
    assert hog > sad > max(vprtempo, pca)


@each_source
def test_slow_methods_come_after_pca_as_on_the_real_frames(source):
    pca, cohog, densevlad = rates(source, 60, (PCA(), CoHOG(), DenseVLAD()))
    assert pca > max(cohog, densevlad)
