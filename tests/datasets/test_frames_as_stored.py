"""Frames as people have them: held on their side by a camera, or of more levels than 8 bits, by every reader."""

import numpy as np
import pytest
from image_folders import lists
from PIL import Image as PillowImage

import vprbench
from vprbench.datasets.folders import folders
from vprbench.datasets.nordland import chosen_names, nordland
from vprbench.datasets.vpr_bench import vpr_bench

PLACES = 2
ON_ITS_SIDE = PillowImage.Exif()
ON_ITS_SIDE[0x0112] = 6  # to be turned clockwise
# Grey levels of 0 to 255 of every place, smooth, so that JPEG keeps them, and the same in no other orientation.
DOWN, ACROSS = np.mgrid[:48, :64]
FRAMES = np.stack([5 * DOWN, 3.75 * ACROSS + DOWN / 4]).astype(np.uint8)
TURNED = np.rot90(FRAMES, 1, axes=(1, 2))  # anticlockwise


def write(folder, frames, suffix=".png", **options):
    folder.mkdir(parents=True, exist_ok=True)
    for number, frame in enumerate(frames):
        PillowImage.fromarray(frame).save(folder / f"{number:03}{suffix}", **options)
    return folder


def shows(images, frames):
    """Tell whether images are these frames but for the few levels that JPEG moves."""
    pairs = zip(images, frames, strict=True)
    return all(
        seen.shape == (*frame.shape, 3) and np.abs(seen.astype(int) - frame[..., None]).max() < 6
        for seen, frame in pairs
    )


def test_thermal_counts_on_their_side_are_turned_and_stretched_and_the_protocol_says_how_they_are_read(tmp_path):
    counts = 7600 + 4 * FRAMES.astype(np.uint16)
    mapped = write(tmp_path / "map", counts)
    asked = write(tmp_path / "asked", np.rot90(counts, 1, axes=(1, 2)), ".tif", exif=ON_ITS_SIDE)
    made = [folders(references=[str(mapped)], queries=str(asked)), vprbench.dataset_of(mapped, asked)]
    levels = (FRAMES - float(FRAMES.min())) * 255 / np.ptp(FRAMES)
    for dataset in made:
        assert (dataset.protocol["exif"], dataset.protocol["levels"]) == ("obey", f"7600..{counts.max()}")
        assert shows(dataset.references, levels)
        assert shows(dataset.queries, levels)
    assert len({dataset.references.fingerprint() for dataset in made}) == 1


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


READERS = {
    "folders": lambda top, **how: folders(references=[f"{top}/0"], queries=f"{top}/1", **how),
    "Python": lambda top, **how: vprbench.dataset_of(top / "0", top / "1", **how),
    "vpr_bench": in_vpr_bench,
    "nordland": in_nordland,
}


@pytest.mark.parametrize("exif", [None, "obey", "ignore"])
@pytest.mark.parametrize("reader", READERS)
def test_every_reader_obeys_tags_of_own_frames_and_ignores_those_of_published_ones(tmp_path, reader, exif):
    write(tmp_path / "0", FRAMES, ".jpg")
    write(tmp_path / "1", TURNED, ".jpg", exif=ON_ITS_SIDE)
    dataset = READERS[reader](tmp_path, **({} if exif is None else {"exif": exif}))
    meant = exif or ("ignore" if reader in ("vpr_bench", "nordland") else "obey")
    assert dataset.protocol["exif"] == meant
    assert shows(dataset.references, FRAMES)
    assert shows(dataset.queries, FRAMES if meant == "obey" else TURNED)
    assert dataset.queries.turned().tolist() == [*range(PLACES)]
    assert not len(dataset.references.turned())
