"""Frames as people have them: held on their side by a camera, or of more levels than 8 bits, by every reader."""

import cv2
import numpy as np
import pytest
from image_folders import lists
from PIL import Image as PillowImage

import vprbench
from vprbench.datasets.folders import folders
from vprbench.datasets.nordland import chosen_names, nordland
from vprbench.datasets.vpr_bench import vpr_bench
from vprbench.methods.sad import SAD

PLACES = 40
ON_ITS_SIDE = PillowImage.Exif()
ON_ITS_SIDE[0x0112] = 6  # to be turned clockwise


def traverse(noise):
    """Grey levels of 0 to 255 of every place, (n, 48, 64): a texture of its own, and the noise of a camera."""
    drawn, seen = np.random.default_rng(0), np.random.default_rng(1)
    cells_of = drawn.uniform(0, 255, (PLACES, 6, 8)).astype(np.float32)
    land = np.stack([cv2.resize(cells, (64, 48), interpolation=cv2.INTER_CUBIC) for cells in cells_of])
    return np.clip(land + noise * seen.normal(0, 1, land.shape), 0, 255)


MAP, ASKED = traverse(0), traverse(20)


def write(folder, frames, suffix=".png", **options):
    folder.mkdir(parents=True, exist_ok=True)
    for number, frame in enumerate(frames):
        PillowImage.fromarray(frame).save(folder / f"{number:03}{suffix}", **options)
    return folder


def bytes_of(levels):
    return np.rint(levels).astype(np.uint8)


def recall(dataset):
    """Share of the queries whose most similar place is the right one, by SAD."""
    scores = SAD().fit(dataset.references, dataset.places).query(dataset.queries)
    hits = [best in right for best, right in zip(scores.argmax(1), dataset.positives, strict=True)]
    return float(np.mean(hits))


def thermal(levels):
    return (7600 + levels * 4).astype(np.uint16)


TURNED = np.rot90(bytes_of(ASKED), 1, axes=(1, 2))  # anticlockwise


def test_sad_finds_every_place_of_thermal_counts_on_their_side_and_the_protocol_says_how_they_are_read(tmp_path):
    mapped = write(tmp_path / "map", thermal(MAP))
    asked = write(tmp_path / "asked", np.rot90(thermal(ASKED), 1, axes=(1, 2)), ".tif", exif=ON_ITS_SIDE)
    made = [folders(references=[str(mapped)], queries=str(asked)), vprbench.dataset_of(mapped, asked)]
    for dataset in made:
        assert (dataset.protocol["exif"], dataset.protocol["levels"]) == ("obey", "7600..8620")
        assert recall(dataset) == 1.0
        assert len({level for image in dataset.queries for level in np.unique(image)}) > 128
    assert len({dataset.references.fingerprint() for dataset in made}) == 1


def in_folders(top, **options):
    return folders(references=[str(top / "0")], queries=str(top / "1"), **options)


def in_hand(top, **options):
    return vprbench.dataset_of(top / "0", top / "1", **options)


def in_vpr_bench(top, **options):
    (top / "0").rename(top / "ref")
    (top / "1").rename(top / "query")
    np.save(top / "ground_truth_new.npy", lists(*([place] for place in range(PLACES))), allow_pickle=True)
    return vpr_bench(root=str(top), **options)


def in_nordland(top, **options):
    names = chosen_names(8, PLACES, 1, ".jpg")
    for part, season in (("0", "spring"), ("1", "summer")):
        for name, path in zip(names, sorted((top / part).iterdir()), strict=True):
            (top / season).mkdir(exist_ok=True)
            path.rename(top / season / name)
    asked = {"references": ["spring"], "places": PLACES, "query_places": PLACES, "first_query_place": 0}
    return nordland(root=str(top), suffix=".jpg", **asked, **options)


OWN, PUBLISHED = [in_folders, in_hand], [in_vpr_bench, in_nordland]


@pytest.mark.parametrize("exif", [None, "obey", "ignore"])
@pytest.mark.parametrize("reader", [*OWN, *PUBLISHED])
def test_every_reader_obeys_tags_of_own_frames_and_ignores_those_of_published_ones(tmp_path, reader, exif):
    write(tmp_path / "0", bytes_of(MAP), ".jpg")
    write(tmp_path / "1", TURNED, ".jpg", exif=ON_ITS_SIDE)
    dataset = reader(tmp_path, **({} if exif is None else {"exif": exif}))
    meant = exif or ("obey" if reader in OWN else "ignore")
    assert dataset.protocol["exif"] == meant
    assert {image.shape for image in dataset.queries} == {(48, 64, 3) if meant == "obey" else (64, 48, 3)}
    assert (recall(dataset) == 1.0) == (meant == "obey")
    assert dataset.queries.turned().tolist() == [*range(PLACES)]
    assert not len(dataset.references.turned())
