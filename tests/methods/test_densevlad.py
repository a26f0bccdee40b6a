"""DenseVLAD against a slow independent version, worked examples and the published file's layout."""

import io

import cv2
import densevlad_oracle as oracle
import numpy as np
import pytest
import scipy.io
import torch
from described_images import drawn_images, encoded
from published_networks import unit

from vprbench.api.images import Images
from vprbench.errors import BadInput
from vprbench.methods.densevlad import dense_sift, vlad
from vprbench.methods.densevlad.method import DenseVLAD


def scene(height=38, width=44):
    """A grey image from 0 to 1 of which one half has almost no contrast."""
    levels = cv2.GaussianBlur(np.random.default_rng(0).random((height, width)), (0, 0), 2)
    levels = (levels - levels.min()) / np.ptp(levels)
    levels[:, width // 2 :] = 0.5 + 1e-4 * levels[:, width // 2 :]
    return levels


def colours(n, height=40, width=48):
    return Images.from_arrays(drawn_images(*[(height, width)] * n))


def sift(grey, arctan="exact"):
    return torch.cat(list(dense_sift.dense_sift(torch.as_tensor(grey), arctan)))


@pytest.mark.parametrize(("arctan", "slow_arctan"), [("exact", ()), ("vlfeat", (oracle.vlfeat_atan2,))])
def test_dense_sift_equals_the_slow_version_in_blocks_of_any_size(arctan, slow_arctan, monkeypatch):
    slow = oracle.dense_sift(scene(), *slow_arctan)
    assert [len(scale) for scale in slow] == [9 * 12, 7 * 10, 6 * 9, 4 * 7]
    assert 0 < (np.concatenate(slow) == 0).all(1).mean() < 0.5
    fast = sift(scene(), arctan)
    assert len(fast) == dense_sift.count_descriptors(*scene().shape)
    np.testing.assert_allclose(fast, np.concatenate(slow), atol=1e-7)
    np.testing.assert_allclose(sift(scene().astype(np.float32), arctan), fast, atol=1e-4)
    monkeypatch.setattr(dense_sift, "_TOGETHER", 20)
    assert torch.equal(sift(scene(), arctan), fast)


def test_grey_is_matlabs_and_halved_without_the_last_row_and_column():
    # 0.298936 * 255 = 76.2; 0.298936 * 10 + 0.587043 * 20 + 0.114021 * 30 = 18.15; 0.587043 * 83 = 48.72
    image = np.array([[[255, 0, 0], [10, 20, 30], [0, 83, 0]]], np.uint8)
    assert dense_sift.make_grey(image).tolist() == [[76, 18, 49]]
    grey = np.arange(30, dtype=np.uint8).reshape(5, 6)
    assert dense_sift.halve_image(grey).tolist() == [[0, 2, 4], [12, 14, 16]]


def test_whitening_keeps_the_directions_of_largest_moment_and_takes_no_mean():
    # One vector a direction, of lengths 3, 2 and 1: moments 9, 4 and 1 thirds; divided by moment's root
    vectors = np.diag([2, 3, 1]).astype(np.float32)
    projection = vlad.learn_whitening(vectors, 2)
    np.testing.assert_allclose(abs(projection), [[0, np.sqrt(3) / 2], [1 / np.sqrt(3), 0], [0, 0]], atol=1e-6)
    assert vlad.learn_whitening(np.ones((3, 4), np.float32), 3).shape == (4, 1)  # the rest is rounding


def test_small_images_and_references_that_show_nothing_are_refused():
    for side, halve, advice in ((21, None, "give larger images"), (42, True, r"method\.halve=false")):
        with pytest.raises(BadInput, match=f"21x21 .*{advice}"):
            DenseVLAD(halve=halve).fit(colours(2, side, side), np.arange(2))
    black = Images.from_arrays([np.zeros((40, 40, 3), np.uint8)] * 3)
    with pytest.raises(BadInput, match=r"gave 0 .*method\.words=6"):
        DenseVLAD(words=6).fit(black, np.arange(3))


@pytest.fixture(scope="module")
def authors(tmp_path_factory):
    """A grey image with flat parts, 128 words in the two layouts of the published ones, and the slow VLAD of it."""
    image = np.repeat(np.round(255 * scene())[:, :, None].astype(np.uint8), 3, axis=2)
    words = unit(np.random.default_rng(6).random((128, 128))).astype(np.float32)
    folder = tmp_path_factory.mktemp("vocabulary")
    scipy.io.savemat(folder / "dnscnt_RDSIFT_K128.mat", {"CX": 3 * words.T})
    np.save(folder / "dnscnt_RDSIFT_K128.cx_norm.npy", words)
    descriptors = np.concatenate(oracle.dense_sift(image[:, :, 0] / 255, oracle.vlfeat_atan2))
    roots = [oracle.root_sift(descriptor) for descriptor in descriptors]
    assert 0.1 < np.mean([not root.any() for root in roots]) < 0.9
    return folder, image, oracle.vlad(roots, words.astype(np.float64), 60)


@pytest.mark.parametrize("file", ["dnscnt_RDSIFT_K128.mat", "dnscnt_RDSIFT_K128.cx_norm.npy"])
def test_with_the_authors_words_and_arc_tangent_a_vlad_is_theirs(authors, file, monkeypatch):
    folder, image, theirs = authors
    monkeypatch.setenv("HOME", str(folder))
    trained = DenseVLAD(vocabulary=f"~/{file}", arctan="vlfeat", n_components=0).fit(colours(2), np.arange(2))
    assert list(trained.files()) == [folder / file]
    np.testing.assert_allclose(encoded(trained, image)[0], theirs, atol=1e-5)


def mat(**arrays):
    stream = io.BytesIO()
    scipy.io.savemat(stream, arrays)
    return stream.getvalue()


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("nowhere.mat", None),
        ("other.mat", mat(CX=np.zeros((128, 7), np.float32))),
        ("whole.mat", mat(CX=np.zeros((128, 6), np.int32))),
        ("wild.mat", mat(CX=np.full((128, 6), np.nan))),
        ("broken.npy", b"no array"),
    ],
)
def test_a_file_that_is_no_vocabulary_is_refused_by_name(tmp_path, name, content):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(BadInput, match=rf"method\.vocabulary=.*{name}"):
        DenseVLAD(words=6, vocabulary=str(tmp_path / name)).fit(colours(12), np.arange(12))
