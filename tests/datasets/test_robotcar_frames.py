"""RobotCar's frames: raw ones processed when looked at, kept, and made anew where what was kept is something else."""

import json
import logging
from concurrent.futures import ThreadPoolExecutor
from hashlib import sha256

import numpy as np
import pytest
from image_folders import answer
from PIL import Image as PillowImage
from robotcar_download import (
    RECORDINGS,
    SITES,
    SMALL,
    STAMPS,
    TABLE,
    TINY,
    bent,
    colour_of,
    grid,
    mosaic,
    raw_folder,
    uniform,
    write_download,
    write_table,
)
from scipy.ndimage import map_coordinates

import vprbench.datasets.oxford_robotcar as robotcar
from vprbench.datasets.oxford_robotcar import kept
from vprbench.datasets.oxford_robotcar.calibration import (
    STEREO_LEFT,
    Camera,
    find_calibration,
    processed,
    read_calibration,
)
from vprbench.errors import BadInput, NotThere
from vprbench.run.identity import fingerprint

# The camera


def calibration(folder, x, y, camera=SMALL):
    return read_calibration(write_table(folder, x, y), camera)


def noise(camera):
    return np.random.default_rng(0).integers(0, 256, (camera.height, camera.width), dtype=np.uint8)


def test_noise_is_demosaiced_to_the_mean_of_the_nearest_pixels_and_its_decimals_cut_off(tmp_path):
    # Every channel inside the frame: the pixel itself, or else its two or four nearest neighbours that record it.
    raw = noise(SMALL)
    seen = processed(raw, calibration(tmp_path, *grid()))
    for y, x, channel in np.ndindex(SMALL.height - 2, SMALL.width - 2, 3):
        by_distance = {}
        for dy, dx in np.ndindex(3, 3):
            if SITES[(y + dy) % 2, (x + dx) % 2] == channel:
                by_distance.setdefault((dy - 1) ** 2 + (dx - 1) ** 2, []).append(int(raw[y + dy, x + dx]))
        nearest = by_distance[min(by_distance)]
        assert seen[y + 1, x + 1, channel] == sum(nearest) // len(nearest)


def test_half_a_pixel_is_the_mean_of_two_and_the_frame_ends_at_its_last_pixel(tmp_path):
    image = uniform((0, 0, 0))
    image[:, :, 1] = 8 * np.arange(16)  # green, a ramp that demosaicing leaves as it is but at the ends
    x, y = grid()
    seen = processed(mosaic(image), calibration(tmp_path, x + 0.5, y))
    np.testing.assert_array_equal(seen[1:-1, 1:14, 1], np.tile(8 * np.arange(1, 14) + 4, (10, 1)))
    flat = processed(mosaic(uniform((90, 80, 70))), calibration(tmp_path, np.minimum(x + 0.75, 15), y))
    np.testing.assert_array_equal(flat, uniform((90, 80, 70)))


@pytest.mark.parametrize("camera", [Camera(40, 30, (1, 1), (1, 1)), STEREO_LEFT], ids=["small", "full size"])
def test_a_bent_table_is_followed_as_scipy_interpolates_in_float64(tmp_path, camera):
    raw = noise(camera)
    x, y = bent(camera)
    straight = processed(raw, calibration(tmp_path / "straight", *grid(camera), camera)).astype(float)
    bent_one = processed(raw, calibration(tmp_path / "bent", x, y, camera))
    exact = np.stack([map_coordinates(straight[:, :, channel], [y, x], order=1) for channel in range(3)], axis=2)
    outside = (x < 0) | (y < 0) | (x > camera.width - 1) | (y > camera.height - 1)
    assert 0.01 < outside.mean() < 0.4
    assert not bent_one[outside].any()
    # `exact` starts from levels whose decimals are cut off: it may be up to a level darker before its own are cut off.
    difference = bent_one - np.floor(exact)
    assert (difference.min(), difference.max()) in ((0, 0), (0, 1))
    assert difference.mean() < 0.5


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (lambda table: table[:-1], "holds 3064 bytes; .* 16 x 12 frames holds 3072"),
        (lambda table: np.where(np.arange(384) == 250, np.nan, table), "not finite"),
        (lambda table: np.where(np.arange(384) == 5, np.inf, table), "not finite"),
        (lambda table: table + 1000, "only 0 %"),
        (lambda table: np.roll(table, 192), "do not grow"),
    ],
    ids=["another size", "no number", "infinity", "outside the frame", "y before x"],
)
def test_a_table_that_is_none_is_refused(tmp_path, spoil, told):
    path = write_table(tmp_path, *grid())
    path.write_bytes(spoil(np.frombuffer(path.read_bytes())).tobytes())
    with pytest.raises(BadInput, match=f"{path} .*{told}.*robotcar-dataset-sdk"):
        read_calibration(path, SMALL)


@pytest.mark.parametrize(
    ("folder", "given"),
    [
        ("models", None),
        ("robotcar-dataset-sdk/models", None),
        ("elsewhere", "elsewhere"),
        ("elsewhere", f"elsewhere/{TABLE}"),
    ],
)
def test_the_table_is_found_in_the_root_or_where_the_option_says(tmp_path, folder, given):
    asked = given and str(tmp_path / given)
    with pytest.raises(NotThere) as error:
        find_calibration(tmp_path, asked)
    assert str(tmp_path / (given or f"robotcar-dataset-sdk/models/{TABLE}")) in str(error.value)
    assert "https://github.com/ori-mrg/robotcar-dataset-sdk" in str(error.value)
    if given:
        write_table(tmp_path / "models", *grid())
    path = write_table(tmp_path / folder, *grid())
    assert find_calibration(tmp_path, asked) == path


# The dataset


@pytest.fixture
def root(tmp_path, monkeypatch):
    monkeypatch.setattr(robotcar, "STEREO_LEFT", SMALL)
    monkeypatch.setenv("VPRBENCH_DATA", str(tmp_path / "no-downloads"))
    return write_download(tmp_path / "robotcar")


@pytest.fixture
def processings(monkeypatch):
    """Grows by one whenever a raw frame is processed."""
    seen = []
    process = kept.processed
    monkeypatch.setattr(kept, "processed", lambda *given: seen.append(None) or process(*given))
    return seen


def dataset(root, **arguments):
    return robotcar.oxford_robotcar(root=str(root), **{**TINY, **arguments})


def frame_path(root, traverse, place):
    return root / RECORDINGS[traverse] / "demosaiced" / f"{STAMPS[traverse][place]}.png"


def raw_path(root, traverse, place):
    return raw_folder(root, traverse) / f"{STAMPS[traverse][place]}.png"


def shows_all(found):
    """Whether references and queries are uniform in the colours of their traverses and places."""
    expected = [colour_of(traverse, place) for traverse in ("sun", "rain") for place in range(4)]
    expected += [colour_of("dusk", place) for place in (1, 2, 3)]
    seen = [*found.references, *found.queries]
    return all((image == uniform(colour)).all() for image, colour in zip(seen, expected, strict=True))


def test_a_frame_is_processed_once_when_it_is_looked_at_and_then_taken_from_where_it_is_kept(root, processings):
    before = sorted(root.rglob("*"))
    found = dataset(root)
    assert sorted(root.rglob("*")) == before
    assert not processings
    assert any(note.startswith("frames of sun, rain, dusk: ") for note in found.notes)
    assert any("can reach 100.00 %" in note for note in found.notes)
    assert found.protocol["also_tolerance_places"] == [1, 2, 3]
    assert shows_all(found)
    assert shows_all(dataset(root))
    assert len(processings) == 11
    path = frame_path(root, "dusk", 1)
    with PillowImage.open(path) as stored:
        assert (stored.format, stored.mode) == ("PNG", "RGB")
        np.testing.assert_array_equal(np.asarray(stored), found.queries[0])
    assert {entry.name for entry in path.parent.iterdir()} >= {path.name, "vprbench.json"}
    record = json.loads((path.parent / "vprbench.json").read_text())
    assert record["calibration_sha256"] == sha256((root / "models" / TABLE).read_bytes()).hexdigest()
    assert (record["width"], record["height"], record["focal_lengths"]) == (16, 12, [9.0, 9.0])
    assert record["code_version"] == kept.VERSION


def test_every_flip_of_a_bit_is_noticed_or_changes_no_pixel(root):
    right = dataset(root).queries[0]
    path = frame_path(root, "dusk", 1)
    content = path.read_bytes()
    with PillowImage.open(path) as stored:
        text = kept.PngInfo()
        text.add_text("vprbench", stored.info["vprbench"])
    PillowImage.new("RGB", (16, 12), (1, 2, 3)).save(path, pnginfo=text)  # other pixels under the same mark
    np.testing.assert_array_equal(dataset(root).queries[0], right)
    for at in range(0, len(content), 17):
        path.write_bytes(content[:at] + bytes([content[at] ^ (1 << at % 8)]) + content[at + 1 :])
        np.testing.assert_array_equal(dataset(root).queries[0], right)


def test_another_table_frame_or_version_makes_a_frame_anew_and_so_does_the_first_one_again(
    root, processings, monkeypatch
):
    PillowImage.fromarray(noise(SMALL)).save(raw_path(root, "dusk", 1))
    x, y = grid()
    straight = dataset(root).queries[0]
    write_table(root / "models", x + 1, y)
    np.testing.assert_array_equal(dataset(root).queries[0][:, :-1], straight[:, 1:])
    write_table(root / "models", x, y)
    for _ in range(2):
        np.testing.assert_array_equal(dataset(root).queries[0], straight)
    assert len(processings) == 3
    raw_path(root, "dusk", 1).write_bytes(raw_path(root, "sun", 3).read_bytes())
    assert (dataset(root).queries[0] == uniform(colour_of("sun", 3))).all()
    monkeypatch.setattr(kept, "VERSION", kept.VERSION + 1)
    dataset(root).queries[0]
    assert len(processings) == 5


def test_the_fingerprint_is_of_the_raw_frames_and_the_table_and_not_of_what_is_kept(root):
    before = fingerprint(dataset(root))
    [*dataset(root).references]
    assert fingerprint(dataset(root)) == before
    x, y = grid()
    write_table(root / "models", x, y + 1e-3)
    assert fingerprint(dataset(root)) != before


def test_another_folder_may_keep_the_frames_and_a_file_in_its_place_costs_a_warning_and_no_frame(
    root, tmp_path, caplog
):
    before, aside = sorted(root.rglob("*")), tmp_path / "aside"
    assert shows_all(dataset(root, processed=str(aside)))
    assert sorted(root.rglob("*")) == before
    assert (aside / RECORDINGS["dusk"] / f"{STAMPS['dusk'][1]}.png").is_file()
    for traverse in RECORDINGS:
        frame_path(root, traverse, 0).parent.write_text("no folder")
    with caplog.at_level(logging.WARNING):
        found = dataset(root)
        assert shows_all(found)
        assert shows_all(found)
    (told,) = (record.getMessage() for record in caplog.records)
    assert "dataset.processed" in told


def test_many_threads_may_look_at_the_same_frames_at_once(root):
    several = [dataset(root) for _ in range(4)]
    with ThreadPoolExecutor(8) as readers:
        images = [*readers.map(lambda i: several[i % 4].references[i % 8], range(64))]
    for i, image in enumerate(images):
        assert (image == uniform(colour_of("sun" if i % 8 < 4 else "rain", i % 4))).all()
    left = [path.name for path in frame_path(root, "sun", 0).parent.iterdir()]
    assert sorted(left) == sorted(["vprbench.json", *(f"{stamp}.png" for stamp in STAMPS["sun"])])


# Whose frames are taken


def write_processed(folder, traverse, places=4, mode="RGB"):
    folder.mkdir(parents=True, exist_ok=True)
    for place in range(places):
        colour = (250, place, 0) if mode == "RGB" else place
        PillowImage.new(mode, (3, 2), colour).save(folder / f"{STAMPS[traverse][place]}.png")


@pytest.mark.parametrize("where", ["demosaiced", "traverse"])
def test_frames_that_somebody_processed_come_before_raw_ones_where_all_are_there(root, where):
    write_processed(frame_path(root, "sun", 0).parent if where == "demosaiced" else root / "sun", "sun")
    found = dataset(root)
    assert [image[0, 0].tolist() for image in found.references[:4]] == [[250, place, 0] for place in range(4)]
    assert (found.references[4] == uniform(colour_of("rain", 0))).all()
    assert any(note.startswith("frames of sun: ") and "by somebody else" in note for note in found.notes)


def test_where_some_are_missing_raw_frames_are_taken_and_those_of_somebody_else_stay_as_they_are(root):
    theirs = frame_path(root, "sun", 0).parent
    write_processed(theirs, "sun", 2)
    before = {path: path.read_bytes() for path in theirs.iterdir()}
    assert shows_all(dataset(root))
    assert shows_all(dataset(root))
    assert {path: path.read_bytes() for path in theirs.iterdir() if path.is_file()} == before


def test_kept_frames_of_one_table_are_enough_without_the_raw_ones(root):
    assert shows_all(dataset(root))
    for traverse in RECORDINGS:
        raw_folder(root, traverse).rename(root / f"moved-{traverse}")
    found = dataset(root)
    assert shows_all(found)
    assert "here before" in found.notes[0]
    (root / "moved-dusk").rename(raw_folder(root, "dusk"))
    x, y = grid()
    write_table(root / "models", x, y + 0.25)
    dataset(root).queries[0]
    raw_folder(root, "dusk").rename(root / "moved-dusk")
    with pytest.raises(BadInput, match="2 of 3 frames in"):
        dataset(root)


@pytest.mark.parametrize(
    ("mode", "size", "told"),
    [
        ("RGB", (16, 12), "is of mode RGB"),
        ("I;16", (16, 12), "is of mode I;16"),
        ("L", (12, 16), "is 12 x 16; raw frames are 16 x 12"),
        ("", (0, 0), "cannot be read as an image"),
    ],
)
def test_a_file_that_is_no_raw_frame_is_named_when_it_is_read(root, mode, size, told):
    for place in (2, 0):  # the first is looked at when the dataset is made
        path = raw_path(root, "sun", place)
        path.write_bytes(path.read_bytes()[:-40])
        if mode:
            PillowImage.new(mode, size).save(path)
        with pytest.raises(BadInput, match=f"{path} {told}"):
            [*dataset(root).references]


@pytest.mark.parametrize("traverse", ["rain", "dusk"])
def test_raw_frames_among_processed_ones_are_refused_for_what_they_are(tmp_path, traverse):
    for name in RECORDINGS:
        write_processed(tmp_path / name, name, mode="L" if name == traverse else "RGB")
    message = answer(dataset, tmp_path)
    assert str(tmp_path / traverse) in message
    assert "raw Bayer frames" in message
    (tmp_path / "sun" / f"{STAMPS['sun'][0]}.png").write_bytes(b"")
    assert f"{STAMPS['sun'][0]}.png cannot be read as an image" in answer(dataset, tmp_path)


def test_without_a_root_the_download_is_taken_whatever_the_dataset_is_called(tmp_path, monkeypatch):
    for traverse in RECORDINGS:
        write_processed(tmp_path / "oxford_robotcar" / traverse, traverse)
    monkeypatch.setenv("VPRBENCH_DATA", str(tmp_path))
    found = robotcar.oxford_robotcar("mine", **TINY)
    assert [image[0, 0].tolist() for image in found.queries] == [[250, place, 0] for place in (1, 2, 3)]
