"""RobotCar: published lists, and raw frames that are processed when they are first looked at."""

import hashlib
import os
import re
import shutil

import numpy as np
import pytest
import yaml
from image_folders import answer, rights
from PIL import Image as PillowImage
from scipy.ndimage import map_coordinates

import vprbench.datasets.oxford_robotcar as robotcar
from vprbench.datasets.oxford_robotcar import calibration, oxford_robotcar, recordings
from vprbench.datasets.oxford_robotcar.calibration import read_calibration, undistort
from vprbench.datasets.oxford_robotcar.lists import RECORDINGS, find_ceiling, published_timestamps, vprsnn_timestamps
from vprbench.errors import BadInput, MissingData
from vprbench.plugins import registry
from vprbench.runs.identity import compute_fingerprint

WIDTH, HEIGHT = 16, 12  # of raw frames here
TINY = {"places": 4, "first_query_place": 1, "query_places": 3}
STAMPS = {traverse: published_timestamps(traverse)[:28:7] for traverse in RECORDINGS}
LEVEL = {"sun": 10, "rain": 60, "dusk": 110}
SITES = np.array([[1, 2], [0, 1]])  # GBRG: the channel that each of four neighbouring pixels records
Y, X = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)


def uniform(traverse, place):
    """Return a frame of the colour of a place, (height, width, 3)."""
    return np.full((12, 16, 3), (LEVEL[traverse] + place, LEVEL[traverse] + 20 + place, 200 - place), np.uint8)


@pytest.fixture(autouse=True)
def _small_frames(monkeypatch):
    monkeypatch.setattr(calibration, "WIDTH", WIDTH)
    monkeypatch.setattr(calibration, "HEIGHT", HEIGHT)


def write_table(folder, x, y):
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "stereo_wide_left_distortion_lut.bin"
    path.write_bytes(np.stack([x.ravel(), y.ravel()]).astype("<f8").tobytes())
    return path


def raw_folder(root, traverse):
    return root / RECORDINGS[traverse] / "stereo" / "left"


def noise():
    return np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH), dtype=np.uint8)


def test_noise_is_demosaiced_to_the_mean_of_the_nearest_pixels(tmp_path):
    # Every channel inside the frame: the pixel itself, or else its two or four nearest neighbours that record it.
    raw = noise()
    seen = undistort(raw, read_calibration(write_table(tmp_path, X, Y)))
    for y, x, channel in np.ndindex(HEIGHT - 2, WIDTH - 2, 3):
        by_distance = {}
        for dy, dx in np.ndindex(3, 3):
            if SITES[(y + dy) % 2, (x + dx) % 2] == channel:
                by_distance.setdefault((dy - 1) ** 2 + (dx - 1) ** 2, []).append(int(raw[y + dy, x + dx]))
        nearest = by_distance[min(by_distance)]
        assert seen[y + 1, x + 1, channel] == sum(nearest) // len(nearest)


def test_a_bent_table_is_followed_bilinearly_and_what_lies_outside_is_black(tmp_path):
    x, y = 1.1 * X - 0.7 - 0.02 * Y * Y, Y + 0.3 + 0.01 * X * X
    straight, seen = (undistort(noise(), read_calibration(write_table(tmp_path, *at))) for at in ((X, Y), (x, y)))
    outside = (x < 0) | (y < 0) | (x > WIDTH - 1) | (y > HEIGHT - 1)
    assert 0.01 < outside.mean() < 0.4
    assert not seen[outside].any()
    wanted = np.stack([map_coordinates(channel, [y, x], float, order=1) for channel in straight.transpose(2, 0, 1)], 2)
    # `straight` has no decimals: what lies between its pixels may be up to a level darker before its own are cut off.
    difference = seen[~outside] - np.floor(wanted[~outside])
    assert (difference.min(), difference.max(), difference.mean() < 0.5) == (0, 1, True)


@pytest.mark.parametrize(
    ("spoil", "told"),
    [(lambda table: table[:-1], "holds 3064 bytes; .*holds 3072"), (lambda table: table + 1000, "only 0 %")],
)
def test_a_table_that_is_none_is_refused(tmp_path, spoil, told):
    path = write_table(tmp_path, X, Y)
    path.write_bytes(spoil(np.frombuffer(path.read_bytes())).tobytes())
    with pytest.raises(BadInput, match=f"{path} .*{told}.*robotcar-dataset-sdk"):
        read_calibration(path)


@pytest.fixture
def root(tmp_path):
    """Raw frames of all traverses, each of one colour, and a table of no distortion."""
    for traverse in RECORDINGS:
        folder = raw_folder(tmp_path / "robotcar", traverse)
        folder.mkdir(parents=True)
        for place, stamp in enumerate(STAMPS[traverse]):
            mosaic = np.take_along_axis(uniform(traverse, place), np.tile(SITES, (6, 8))[:, :, None], axis=2)[:, :, 0]
            PillowImage.fromarray(mosaic).save(folder / f"{stamp}.png")
    write_table(tmp_path / "robotcar" / "models", X, Y)
    return tmp_path / "robotcar"


def dataset(root, **arguments):
    return robotcar.oxford_robotcar(root=str(root), **{**TINY, **arguments})


def shows_all(found):
    """Whether references and queries are uniform in the colours of their traverses and places."""
    expected = [uniform(traverse, place) for traverse in ("sun", "rain") for place in range(4)]
    expected += [uniform("dusk", place) for place in (1, 2, 3)]
    return np.array_equal([*found.references, *found.queries], expected)


def test_a_frame_is_processed_once_when_it_is_looked_at_and_anew_for_another_table(root, monkeypatch):
    processings, process = [], recordings.undistort
    monkeypatch.setattr(recordings, "undistort", lambda *given: processings.append(None) or process(*given))
    before = sorted(root.rglob("*"))
    found = dataset(root)
    assert not processings
    assert found.notes[0].startswith("frames of sun, rain, dusk: demosaiced and undistorted here")
    assert any("can reach 100.00 %" in note for note in found.notes)
    assert found.protocol["also_tolerance_places"] == [1, 2, 3]
    assert shows_all(found)
    assert shows_all(dataset(root))
    assert shows_all(dataset(root, tolerance=1))
    assert len(processings) == 11
    assert sorted(root.rglob("*")) == before
    PillowImage.fromarray(noise()).save(raw_folder(root, "dusk") / found.queries.names[0])
    write_table(root / "models", X + 0.25, Y)
    assert compute_fingerprint(dataset(root)) != compute_fingerprint(found)
    bent = dataset(root).queries[0]
    write_table(root / "models", X + 1.25, Y)
    np.testing.assert_array_equal(dataset(root).queries[0][:, :-2], bent[:, 1:-1])
    assert len(processings) == 13


def write_processed(folder, traverse, places=4):
    folder.mkdir(parents=True, exist_ok=True)
    for place in range(places):
        PillowImage.new("RGB", (3, 2), (250, place, 0)).save(folder / f"{STAMPS[traverse][place]}.png")


@pytest.mark.parametrize("where", ["demosaiced", "traverse"])
def test_frames_that_somebody_processed_come_before_raw_ones_where_all_are_there(root, where):
    theirs = root / RECORDINGS["sun"] / "demosaiced" if where == "demosaiced" else root / "sun"
    write_processed(theirs, "sun", 2)
    assert shows_all(dataset(root))
    shutil.rmtree(theirs)
    write_processed(theirs, "sun")
    found = dataset(root)
    assert [image[0, 0].tolist() for image in found.references[:4]] == [[250, place, 0] for place in range(4)]
    assert (found.references[4] == uniform("rain", 0)).all()
    assert found.notes[1] == "frames of sun: demosaiced and undistorted by somebody else, how is not recorded"


@pytest.mark.parametrize(
    ("mode", "size", "told"),
    [
        ("I;16", (16, 12), "is 16 x 12 of mode I;16"),
        ("L", (12, 16), "is 12 x 16 of mode L; raw frames are 16 x 12"),
        ("", (0, 0), "cannot be read as an image"),
    ],
)
def test_a_file_that_is_no_raw_frame_is_named_when_it_is_read(root, mode, size, told):
    for place in (2, 0):  # the first is looked at when the dataset is made
        path = raw_folder(root, "sun") / f"{STAMPS['sun'][place]}.png"
        path.write_bytes(path.read_bytes()[:-40])
        if mode:
            PillowImage.new(mode, size).save(path)
        with pytest.raises(BadInput, match=f"{path} {told}"):
            [*dataset(root).references]


PUBLISHED = {traverse: published_timestamps(traverse)[:3150:7] for traverse in RECORDINGS}


@pytest.fixture(autouse=True)
def _no_downloads(tmp_path, monkeypatch):
    monkeypatch.setenv("VPRBENCH_DATA", str(tmp_path / "downloads"))


def one_frame_under(root, stamps):
    """Put one processed frame under all the names of every traverse."""
    for traverse, listed in stamps.items():
        (root / traverse).mkdir(parents=True)
        PillowImage.new("RGB", (3, 2)).save(root / traverse / "frame.png")
        for stamp in {*listed}:
            os.link(root / traverse / "frame.png", root / traverse / f"{stamp}.png")
    return root


def test_the_lists_are_those_that_were_published():
    # sha256 of the whole original files, header and row numbers included; QVPR/VPRTempo 64154e5, orc-*.csv.
    digests = {
        "sun": "3ac989cf3ccb4065b5ad71e8410a25db50791160473e30ec75b0cc7f7d5a86ee",
        "rain": "000c064fec256cd4ecd0eea769f1c9b318f7ff00b3dc759a070ffd52c2a90338",
        "dusk": "0740768981b3065bb6e74b01a80845d6f09ea3f90d2c3152fcabb8bd4c27f019",
    }
    for traverse, digest in digests.items():
        rows = [f"{stamp}.png,{row}" for row, stamp in enumerate(published_timestamps(traverse))]
        original = "".join(f"{line}\n" for line in ["Image name,index", *rows])
        assert hashlib.sha256(original.encode()).hexdigest() == digest


def test_the_queries_of_the_paper_are_places_90_to_449_and_it_is_told_what_is_odd_about_the_list(tmp_path):
    # 445 and 448 of the 450 reference images are distinct, and all 360 queries; steps back of 450 places: 55 and 59.
    paper = oxford_robotcar(root=str(one_frame_under(tmp_path, PUBLISHED)))
    assert (paper.queries.names[0], paper.queries.names[-1]) == ("1416586236868041.png", "1416587169054477.png")
    assert rights(paper) == [[place] for place in range(90, 450)]
    assert (paper.n_places, paper.places.tolist()) == (450, [*range(450), *range(450)])
    assert dict(paper.protocol) == {
        **{"protocol": "vprtempo", "image_list": "vprtempo", "references": ["sun", "rain"], "query": "dusk"},
        **{"stride": 7, "places": 450, "query_places": 360, "first_query_place": 90, "reference_places": 450},
        **{"held_out_places": 90, "tolerance_places": 0, "also_tolerance_places": [1, 2, 3]},
        "repeated_images": {"sun": 5, "rain": 2, "queries": 0},
        "steps_back_in_time": {"sun": 55, "rain": 59, "queries": 4},
    }
    # none of the repeated images stands at more than two places
    images, steps = (re.findall(r"[\d.]+", note) for note in paper.notes if "lead back" in note or "can reach" in note)
    assert images == ["10", "450", "4", "450", "0", "360", "1", "0", "99.72"]  # 359 of 360
    assert steps == ["55", "449", "59", "449", "4", "359"]


START = {"sun": 1439388276045321, "rain": 1446121117630140, "dusk": 1416586027583964}


def stamps(traverse):
    """The timestamps of a made-up list: a row repeats the one before it now and then, but none of every eighth."""
    return [START[traverse] + 1000 * (row - (row % 8 == 3)) for row in range(3876)]


def write_list(folder, traverse, lines):
    folder.mkdir(parents=True, exist_ok=True)
    text = "".join(f"{line}\n" for line in lines)
    (folder / f"ORC_{traverse.capitalize()}_timestamps.csv").write_text(text, errors="surrogateescape")


PLAIN = [f"{stamp}.png" for stamp in stamps("sun")]


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        (["head", *PLAIN[:3875]], "it names 3875"),
        ([*PLAIN[:16], PLAIN[8], *PLAIN[17:]], "449 distinct ones in every 8th row, not 450"),
        ([], "does not exist"),
    ],
    ids=["too short", "a repeat", "missing"],
)
def test_another_list_is_refused_with_where_to_get_the_right_one(tmp_path, lines, told):
    if lines:
        write_list(tmp_path, "sun", lines)
    message = answer(vprsnn_timestamps, tmp_path, "sun", kind=BadInput if lines else MissingData)
    assert f"{tmp_path / 'ORC_Sun_timestamps.csv'}" in message
    assert told in message
    assert "https://github.com/QVPR/VPRSNN" in message


def test_the_places_are_every_eighth_row_without_those_set_aside_and_lists_may_lie_outside_of_the_root(tmp_path):
    root = one_frame_under(tmp_path / "robotcar", {name: stamps(name)[:3600:8] for name in RECORDINGS})
    for traverse in RECORDINGS:
        write_list(root / "lists", traverse, [f"{row},{stamp}.png" for row, stamp in enumerate(stamps(traverse))])
    config = yaml.safe_load(registry.find_entries("dataset")["oxford_robotcar_vprsnn"].path.read_text("utf-8"))

    def asked(**arguments):
        return registry.make_dataset({**config, "root": str(root), **arguments})

    dataset = asked()
    aside = set(np.random.RandomState(42).permutation(450)[:75].tolist())
    wanted = [f"{stamps('dusk')[8 * place]}.png" for place in range(450) if place not in aside]
    assert list(dataset.queries.names) == wanted
    assert (len(dataset.queries), dataset.n_places, len(dataset.references)) == (375, 375, 750)
    assert rights(dataset) == [[place] for place in range(375)]
    assert (dataset.protocol["protocol"], dataset.protocol["image_list"]) == ("vprsnn", "vprsnn")
    assert (dataset.protocol["held_out_places"], dataset.protocol["also_tolerance_places"]) == (75, [1, 2, 3])
    download = tmp_path / "downloads" / "oxford_robotcar" / "lists"
    download.parent.mkdir(parents=True)
    (root / "lists").rename(download)
    assert len(asked().queries) == 375
    named = download.rename(tmp_path / "named")
    assert len(asked(lists=str(named)).queries) == 375
    assert "dataset.lists" in answer(asked, kind=MissingData)


@pytest.mark.parametrize(
    ("references", "queries", "right", "best"),
    [
        ("abb", "xy", [[0], [1]], 0.75),  # a tie of two for y
        ("abb", "xxx", [[0], [1], [1, 2]], 0.5),  # b is right for half of one and all of another, a for one
        ("aab", "xyy", [[0, 2], [], [0, 1]], 2 / 3),  # two lack nothing, one has no right place
    ],
)
def test_the_ceiling_is_reached_by_the_best_group_of_places_for_each_image(references, queries, right, best):
    assert find_ceiling(references, queries, right) == pytest.approx(best)
