"""The rendered railway is about as hard as real frames of Nordland, and the street as hard as a benchmark has to be."""

from functools import cache

import cv2
import numpy as np
import pytest
from checkout import SHARED

from vprbench.api.images import Images
from vprbench.datasets.street import street
from vprbench.datasets.synthetic import synthetic
from vprbench.methods.cohog import CoHOG
from vprbench.methods.densevlad.method import DenseVLAD
from vprbench.methods.hog import HOG
from vprbench.methods.pca import PCA
from vprbench.methods.sad import SAD
from vprbench.methods.vprtempo.method import VPRTempo

NORDLAND = SHARED / "data" / "nordland_64x32"
needs_nordland = pytest.mark.real_frames
PLACES = 2761  # of the real frames
PATCH = 8

# R@1 of the real frames, winter found again in summer, published beside them (nordland_64x32/README.md).
REAL = {100: 0.41, 200: 0.355, 400: 0.29}

each_source = pytest.mark.parametrize("source", ["railway", pytest.param("nordland", marks=needs_nordland)])


def evenly(count):
    """Return so many of the places, evenly spaced."""
    return np.linspace(0, PLACES - 1, count).astype(int).tolist()


@cache
def rendered(season, seed):
    return synthetic(places=PLACES, references=[season], query=season, seed=seed).references


@cache
def railway(season, place, seed=0):
    """Return a frame as small and grey as the real ones are."""
    frame = cv2.cvtColor(rendered(season, seed)[place], cv2.COLOR_RGB2GRAY)
    return cv2.resize(frame, (64, 32), interpolation=cv2.INTER_AREA)


@cache
def real_names():
    return (NORDLAND / "frames_clean_qvpr.txt").read_text().split()


def nordland(season, place):
    return cv2.imread(str(NORDLAND / season / real_names()[place]), cv2.IMREAD_GRAYSCALE)


def subset(source, season, count, **asked):
    """Return evenly spaced frames of a season, (count, 32, 64)."""
    frame = {"railway": railway, "nordland": nordland}[source]
    return np.stack([frame(season, place, **asked) for place in evenly(count)])


def normalised(frames):
    """Return each patch of 8x8 pixels minus its mean, over its standard deviation; a flat patch is 0."""
    n, height, width = frames.shape
    patches = frames.astype(np.float32).reshape(n, height // PATCH, PATCH, width // PATCH, PATCH)
    mean, spread = patches.mean((2, 4), keepdims=True), patches.std((2, 4), keepdims=True)
    return ((patches - mean) / np.where(spread > 0, spread, 1)).reshape(n, -1)


def recall(source, count, **asked):
    """Return the share of winter's frames whose most similar frame in summer, as SeqSLAM sees, is of the same place."""
    winter, summer = (normalised(subset(source, season, count, **asked)) for season in ("winter", "summer"))
    found = [np.abs(summer - query).mean(axis=1).argmin() for query in winter]
    return np.mean(found == np.arange(count))


@needs_nordland
@pytest.mark.parametrize("count", [100, 400])
def test_seqslams_differences_find_on_real_frames_what_was_published_with_them(count):
    assert recall("nordland", count) == pytest.approx(REAL[count], abs=0.005)


@pytest.mark.parametrize(("count", "seed"), [(100, 0), (200, 0), (100, 1)])
def test_winter_is_found_again_in_summer_as_often_as_on_real_frames(count, seed):
    assert recall("railway", count, **{"seed": seed} if seed else {}) == pytest.approx(REAL[count], abs=0.08)


def rates(source, count, methods):
    """R@1 of methods that know winter and are asked in summer, as on all of nordland_64x32."""
    references, queries = (
        Images.from_arrays([cv2.cvtColor(frame, cv2.COLOR_GRAY2RGB) for frame in subset(source, season, count)])
        for season in ("winter", "summer")
    )
    right = np.arange(count)
    return [(method.fit(references, right).query(queries).argmax(axis=1) == right).mean() for method in methods]


@pytest.mark.extended
@each_source
def test_methods_come_in_the_order_of_the_real_frames(source):
    # On all 2761 real places: HOG 34.8 %, SAD 25.0, VPRTempo 19.3, PCA 18.5, CoHOG 5.1, DenseVLAD 4.7. The intervals of
    # VPRTempo and PCA overlap, and so do those of CoHOG and DenseVLAD.
    hog, sad, vprtempo, pca = rates(source, 400, (HOG(), SAD(), VPRTempo(max_module=400), PCA()))
    assert hog > sad > max(vprtempo, pca)
    pca, cohog, densevlad = rates(source, 60, (PCA(), CoHOG(), DenseVLAD()))
    assert pca > max(cohog, densevlad)


def test_every_place_of_the_street_is_found_again_in_the_frame_itself_and_few_across_weather():
    # What makes it a benchmark: the same frames match perfectly, dusk against sun and rain between 25 and 50 %.
    dataset = street()
    method = SAD().fit(dataset.references[::2], np.arange(450) % 225)
    best = method.query(dataset.queries[::2]).argmax(axis=1)
    assert 0.25 <= (best == np.arange(45, 225)).mean() <= 0.5
    assert np.array_equal(method.query(dataset.references[0:450:18]).argmax(axis=1), np.arange(0, 225, 9))
