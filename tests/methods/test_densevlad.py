"""DenseVLAD against a slow independent version, worked examples, the published file's layout and real frames."""

from __future__ import annotations

import cv2
import densevlad_oracle as oracle
import numpy as np
import pytest
import scipy.io
import torch
from checkout import SHARED

from vprbench.api.images import Images
from vprbench.errors import BadInput
from vprbench.methods.densevlad import dense_sift, method, vlad
from vprbench.methods.densevlad.method import DenseVLAD

needs_shared = pytest.mark.skipif(
    not (SHARED / "data" / "corridor").is_dir(), reason="the folder shared/ is not beside the checkout"
)


def scene(height=38, width=44, seed=0):
    """A grey image from 0 to 1 of which one half has almost no contrast."""
    levels = cv2.GaussianBlur(np.random.default_rng(seed).random((height, width)), (0, 0), 2)
    levels = (levels - levels.min()) / np.ptp(levels)
    levels[:, width // 2 :] = 0.5 + 1e-4 * levels[:, width // 2 :]
    return levels


def colours(n, height=40, width=48, seed=0):
    generator = np.random.default_rng(seed)
    coarse = generator.integers(0, 256, (n, 6, 7, 3), dtype=np.uint8)
    return Images.from_arrays([cv2.resize(one, (width, height), interpolation=cv2.INTER_CUBIC) for one in coarse])


def fitted(n=12, **arguments):
    return DenseVLAD(**{"words": 6, **arguments}).fit(colours(n), np.arange(n))


def sift(grey):
    return torch.cat(list(dense_sift.dense_sift(torch.as_tensor(grey))))


def unit(rows):
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


@pytest.fixture(scope="module")
def slow():
    """The oracle's descriptors of `scene()`, scale by scale."""
    return oracle.dense_sift(scene())


def test_dense_sift_equals_the_slow_version(slow):
    assert [len(scale) for scale in slow] == [9 * 12, 7 * 10, 6 * 9, 4 * 7]
    assert 0 < (np.concatenate(slow) == 0).all(1).mean() < 0.5
    fast = sift(torch.tensor(scene(), dtype=torch.float32)).numpy()
    assert fast.dtype == np.float32
    np.testing.assert_allclose(fast, np.concatenate(slow), atol=1e-4)


def test_the_whole_chain_equals_the_slow_version(slow):
    words = unit(np.random.default_rng(1).random((9, 128)))
    expected = oracle.vlad([oracle.root_sift(descriptor) for descriptor in np.concatenate(slow)], words)
    blocks = (dense_sift.root_sift(block) for block in dense_sift.dense_sift(torch.from_numpy(scene())))
    np.testing.assert_allclose(vlad.vlad(blocks, torch.from_numpy(words)), expected, atol=1e-4)


def test_a_small_block_size_changes_no_descriptor(monkeypatch):
    together = sift(scene())
    monkeypatch.setattr(dense_sift, "_TOGETHER", 20)
    assert torch.equal(sift(scene()), together)


@pytest.mark.parametrize(
    ("turn", "orientations"), [(0, {0}), (2, {2}), (4, {4}), (6, {6}), (0.5, {0, 1}), (7.5, {7, 0})]
)
def test_an_even_slope_is_seen_in_its_own_orientations_alone(turn, orientations):
    # eighths of a turn, from right to down; in the middle of a large image, which its borders do not reach
    angle = turn * np.pi / 4
    y, x = np.mgrid[:80, :80] / 160
    grey = 0.5 + np.cos(angle) * (x - 0.25) + np.sin(angle) * (y - 0.25)
    scale = next(iter(dense_sift.dense_sift(torch.from_numpy(grey)))).numpy().reshape(30, 30, 16, 8)
    strengths = scale[15, 15].sum(0)
    assert set(np.flatnonzero(strengths > 1e-6)) == orientations
    assert np.ptp(strengths[list(orientations)]) < 1e-6


@pytest.mark.parametrize(("height", "width"), [(22, 22), (31, 31), (32, 64), (38, 45)])
def test_the_number_of_descriptors_is_known_beforehand(height, width):
    assert len(sift(np.zeros((height, width)))) == dense_sift.n_descriptors(height, width) > 0


def test_grey_is_matlabs():
    # 0.298936 * 255 = 76.2; 0.298936 * 10 + 0.587043 * 20 + 0.114021 * 30 = 18.15; 0.587043 * 83 = 48.72
    image = np.array([[[255, 0, 0], [10, 20, 30], [0, 83, 0]]], np.uint8)
    assert dense_sift.grey_levels(image).tolist() == [[76, 18, 49]]


def test_halving_keeps_every_second_pixel_but_for_the_last_row_and_column():
    grey = np.arange(30, dtype=np.uint8).reshape(5, 6)
    assert dense_sift.halved(grey).tolist() == [[0, 2, 4], [12, 14, 16]]


def test_root_sift_cuts_to_whole_levels_up_to_255():
    # 512 * 0.6 = 307 -> 255; 512 * 0.0997 = 51.05 -> 51; 512 * 0.001 -> 0: shares 255 / 306 and 51 / 306
    found = dense_sift.root_sift(torch.tensor([[0.6, 0.0997, 0.001]]))
    np.testing.assert_allclose(found, np.sqrt([[5 / 6, 1 / 6, 0]]), rtol=1e-6)


def test_vlad_lays_out_word_after_word_with_a_unit_residual_each():
    words = torch.tensor([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]])
    # Word 0: (0.8, 0.6, 0) - (1, 0, 0) = (-0.2, 0.6, 0); word 2, twice: (0.6, 0, 0.8) - (0, 0, 1) = (0.6, 0, -0.2)
    descriptors = torch.tensor([[0.6, 0, 0.8], [0.8, 0.6, 0], [0.6, 0, 0.8]])
    one = np.array([0.2, 0.6]) / np.sqrt(0.4)
    expected = np.array([-one[0], one[1], 0, 0, 0, 0, one[1], 0, -one[0]]) / np.sqrt(2)
    np.testing.assert_allclose(vlad.vlad([descriptors], words), expected, atol=1e-6)


def test_a_zero_descriptor_belongs_to_the_first_word():
    words = torch.tensor([[0.6, 0.8], [1, 0]])
    np.testing.assert_allclose(vlad.vlad([torch.zeros(3, 2)], words), [-0.6, -0.8, 0, 0], atol=1e-6)


def test_what_rounding_leaves_of_a_residual_is_none():
    words = torch.from_numpy(unit(np.random.default_rng(0).random((4, 128)))).float()
    assert not vlad.vlad([words[[2] * 1000]], words).any()


def test_whitened_vectors_have_unit_moments_and_no_mean_is_taken():
    vectors = np.random.default_rng(0).random((50, 9)).astype(np.float32) + 1
    white = vectors @ vlad.whitening(vectors, 9)
    np.testing.assert_allclose(white.T @ white / 50, np.eye(9), atol=1e-4)
    assert abs(white.mean(0)).max() > 0.9  # of the direction of the mean


def test_whitening_keeps_the_directions_of_largest_moment():
    # One vector a direction, of lengths 3, 2 and 1: moments 9, 4 and 1 thirds; divided by moment's root
    vectors = np.diag([2, 3, 1]).astype(np.float32)
    projection = vlad.whitening(vectors, 2)
    np.testing.assert_allclose(abs(projection), [[0, np.sqrt(3) / 2], [1 / np.sqrt(3), 0], [0, 0]], atol=1e-6)


def test_whitening_keeps_no_direction_that_the_vectors_do_not_have():
    vectors = np.random.default_rng(0).random((3, 40)).astype(np.float32)[[0, 1, 2, 0, 1]]
    assert vlad.whitening(vectors, 5).shape == (40, 3)


def test_the_seed_decides_the_words():
    first, again, other = (fitted(seed=seed).state()["words"] for seed in (0, 0, 1))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


@pytest.mark.parametrize(
    ("n", "n_components", "shape"), [(16, 1024, (3, 4)), (16, 2, (3, 2)), (12, 0, (3, 6 * 128)), (12, 1024, (3, 3))]
)
def test_there_is_at_most_a_component_for_four_references_and_for_those_asked(n, n_components, shape):
    codes = fitted(n=n, n_components=n_components).encode(colours(3))
    assert codes.shape == shape
    np.testing.assert_allclose(np.linalg.norm(codes, axis=1), 1, atol=1e-5)


def test_references_beyond_the_sample_are_in_the_map(monkeypatch):
    monkeypatch.setattr(method, "_WHITENED_IMAGES", 8)
    monkeypatch.setattr(method, "_SAMPLED_IMAGES", 5)
    trained = fitted(n=12, n_components=2)
    np.testing.assert_allclose(trained.state()["references"], trained.encode(colours(12)), atol=1e-5)


def test_a_state_with_whitening_is_refused_where_none_is_wanted():
    with pytest.raises(BadInput, match="the stored network holds"):
        DenseVLAD(words=6, n_components=0).restore(fitted().state())
    with pytest.raises(BadInput, match="the stored network holds"):
        DenseVLAD(words=6).restore({})


@pytest.mark.parametrize(
    ("arguments", "message"), [({"words": 0}, "words=0"), ({"n_components": -1}, "n_components=-1")]
)
def test_an_argument_without_sense_is_refused(arguments, message):
    with pytest.raises(BadInput, match=f"method.{message}: give"):
        fitted(**arguments)


def test_references_that_show_nothing_are_refused():
    black = Images.from_arrays([np.zeros((40, 40, 3), np.uint8)] * 3)
    with pytest.raises(BadInput, match=r"gave 0 .*method\.words=6"):
        DenseVLAD(words=6).fit(black, np.arange(3))


def test_images_of_64x32_are_accepted():
    small = colours(8, height=32, width=64)
    assert DenseVLAD(words=6).fit(small, np.arange(8)).query(small).argmax(1).tolist() == list(range(8))


@pytest.mark.parametrize(
    ("side", "halve", "advice"), [(21, None, "give larger images"), (42, True, r"set method\.halve=false")]
)
def test_too_small_an_image_is_refused_with_its_size(side, halve, advice):
    with pytest.raises(BadInput, match=rf"21x21 .* 22x22; {advice}"):
        DenseVLAD(halve=halve).fit(colours(2, height=side, width=side), np.arange(2))


@pytest.mark.parametrize(
    ("width", "halve", "seen"),
    [(640, None, (60, 640)), (642, None, (30, 321)), (642, False, (60, 642)), (80, True, (30, 40))],
)
def test_images_are_halved_where_longer_than_640_pixels_or_asked_for(width, halve, seen):
    assert DenseVLAD(halve=halve)._grey(np.zeros((60, width, 3), np.uint8)).shape == seen


@pytest.fixture
def published(tmp_path):
    """A vocabulary in the layout of dnscnt_RDSIFT_K128.mat: CX, 128 dimensions x 6 words, not of unit length."""
    centres = np.random.default_rng(5).random((128, 6)).astype(np.float32)
    path = tmp_path / "dnscnt_RDSIFT_K6.mat"
    scipy.io.savemat(path, {"CX": centres})
    return path, centres


@pytest.fixture(scope="module")
def authors(tmp_path_factory):
    """A grey image with flat parts, 128 words in the two layouts of the published ones, and the slow VLAD of both."""
    image = np.repeat(np.round(255 * scene())[:, :, None].astype(np.uint8), 3, axis=2)
    words = unit(np.random.default_rng(6).random((128, 128))).astype(np.float32)
    folder = tmp_path_factory.mktemp("vocabulary")
    scipy.io.savemat(folder / "dnscnt_RDSIFT_K128.mat", {"CX": 3 * words.T})
    np.save(folder / "dnscnt_RDSIFT_K128.cx_norm.npy", words)
    descriptors = np.concatenate(oracle.dense_sift(image[:, :, 0] / 255, oracle.vlfeat_atan2))
    roots = [oracle.root_sift(descriptor) for descriptor in descriptors]
    assert 0.1 < np.mean([not root.any() for root in roots]) < 0.9
    return folder, image, [oracle.vlad(roots, words.astype(np.float64), zero) for zero in (60, 0)]


@pytest.mark.parametrize("file", ["dnscnt_RDSIFT_K128.mat", "dnscnt_RDSIFT_K128.cx_norm.npy"])
def test_with_the_authors_words_and_arc_tangent_a_vlad_is_theirs(authors, file):
    folder, image, (theirs, zeros_elsewhere) = authors
    trained = DenseVLAD(vocabulary=str(folder / file), arctan="vlfeat", n_components=0).fit(colours(2), np.arange(2))
    (code,) = trained.encode(Images.from_arrays([image]))
    np.testing.assert_allclose(code, theirs, atol=1e-5)
    assert np.abs(theirs - zeros_elsewhere).max() > 0.02


def test_the_arc_tangent_may_be_vlfeats():
    grey = torch.from_numpy(scene())
    slow = np.concatenate(oracle.dense_sift(scene(), oracle.vlfeat_atan2))
    fast = torch.cat(list(dense_sift.dense_sift(grey, "vlfeat"))).numpy()
    np.testing.assert_allclose(fast, slow, atol=1e-7)
    assert np.abs(fast - sift(grey).numpy()).max() > 1e-3


def test_a_vocabulary_may_stand_in_the_home_folder(published, monkeypatch):
    path, centres = published
    for variable in ("HOME", "USERPROFILE"):
        monkeypatch.setenv(variable, str(path.parent))
    method = DenseVLAD(vocabulary=f"~/{path.name}", words=6)
    assert list(method.files()) == [path]
    words = fitted(vocabulary=f"~/{path.name}").state()["words"]
    np.testing.assert_allclose(words, unit(centres.T), atol=1e-6)


def mat(**arrays):
    def write(path):
        scipy.io.savemat(path, arrays)

    return write


def cut_off(compressed):
    def write(path):
        scipy.io.savemat(path, {"CX": np.random.default_rng(0).random((128, 6))}, do_compression=compressed)
        path.write_bytes(path.read_bytes()[:700])

    return write


@pytest.mark.parametrize(
    ("name", "write", "complaint"),
    [
        ("nowhere.mat", lambda path: None, "is no file"),
        ("other.mat", mat(CX=np.zeros((128, 7), np.float32)), r"128x7 float32.* 128x6 "),
        ("other.mat", mat(X=np.zeros(3)), "holds no CX"),
        *(
            (f"broken.{suffix}", lambda path, content=content: path.write_bytes(content), "could not be read")
            for suffix, content in [
                ("mat", b""),
                ("mat", b"not a vocabulary " * 20),
                ("mat", b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"),
                ("npy", b""),
                ("npy", b"no array"),
                ("npy", b"\x93NUMPY\x01\x00"),
            ]
        ),
        *(("broken.mat", cut_off(compressed), "could not be read") for compressed in (False, True)),
    ],
)
def test_a_file_that_is_no_vocabulary_is_refused_by_name(tmp_path, name, write, complaint):
    write(tmp_path / name)
    with pytest.raises(BadInput, match=rf"method\.vocabulary=.*{name} .*{complaint}"):
        fitted(vocabulary=str(tmp_path / name))


@needs_shared
def test_densevlad_on_corridor_beats_sad_and_the_stored_densevlad():
    # Right is within two frames: SAD 0.4414 (README of the data), VPR-Bench's stored DenseVLAD 78 of 111.
    references, queries = (
        Images.from_files(sorted((SHARED / "data" / "corridor" / traverse).glob("*.jpg")))
        for traverse in ("ref", "query")
    )
    best = DenseVLAD().fit(references, np.arange(111)).query(queries).argmax(1)
    assert np.count_nonzero(np.abs(best - np.arange(111)) <= 2) >= 78
