"""The doctor's look at every frame: unreadable, of another size, in colour or grey, black, repeated, shared."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from doctored import NAMES, PLACES, dataset_of, examined, healthy, notes, save, season, wrong
from PIL import Image as PillowImage

from vprbench.data.doctor import examine
from vprbench.progress import listening


def test_all_unreadable_frames_are_counted_and_five_are_named_with_the_reason(tmp_path: Path) -> None:
    winter, summer = healthy(tmp_path)
    for name in NAMES[3:10]:
        (summer / name).write_bytes((summer / name).read_bytes()[:900])

    assert wrong(examined(winter, summer)) == [
        (
            "error",
            "decoding",
            "7 of 60 frames of summer cannot be read as an image (image file is truncated): "
            "003.png, 004.png, 005.png, 006.png, 007.png and 2 more",
        )
    ]


def test_a_page_as_large_as_an_image_is_found_where_every_frame_is_decoded(tmp_path: Path) -> None:
    winter, summer = healthy(tmp_path)
    size = (winter / "017.png").stat().st_size
    (winter / "017.png").write_bytes(b"Service unavailable. ".ljust(size))

    told = "1 of 60 frames of winter cannot be read as an image (cannot identify image file): 017.png"
    assert wrong(examined(winter, summer)) == [("error", "decoding", told)]


def test_every_other_check_goes_on_where_no_frame_of_a_traverse_is_readable(tmp_path: Path) -> None:
    winter, summer = healthy(tmp_path)
    for name in NAMES:
        (winter / name).write_bytes(b"nothing")

    found = examined(winter, summer)

    assert [check for _, check, _ in wrong(found)] == ["decoding"]
    assert notes(found, "alignment") == ["not checked: a traverse has 0 frames to compare, and 20 are needed"]


def test_a_few_frames_of_another_size_are_named(tmp_path: Path) -> None:
    winter, summer = healthy(tmp_path)
    for name in NAMES[40:42]:
        PillowImage.open(summer / name).resize((32, 16)).save(summer / name)

    assert wrong(examined(winter, summer)) == [
        ("warning", "size", "2 frames of summer are not 64x32, as the other 58 are: 040.png, 041.png")
    ]


def test_a_traverse_of_many_sizes_is_only_noted(tmp_path: Path) -> None:
    winter, summer = healthy(tmp_path)
    for name in NAMES[:20]:
        PillowImage.open(summer / name).resize((128, 64)).save(summer / name)

    found = examined(winter, summer)

    assert not wrong(found)
    assert notes(found, "size") == ["frames of summer have 2 sizes: 64x32 (40), 128x64 (20)"]


def test_traverses_that_differ_in_size_and_colour_are_noted(tmp_path: Path) -> None:
    winter = save(tmp_path / "winter", season(0))
    red = np.array([1.0, 0.8, 0.6])
    summer = save(tmp_path / "summer", [(frame[::2, ::2] * red).astype(np.uint8) for frame in season(1)])

    found = examined(winter, summer)

    assert not wrong(found)
    assert notes(found, "size") == ["traverses differ in the size of their frames: winter 64x32, summer 32x16"]
    assert notes(found, "colour") == ["some frames are grey, others in colour: winter grey, summer in colour"]


@pytest.mark.parametrize(
    ("grey", "what"),
    [(0, "black (mean below 16 of 255)"), (200, "of one grey value (standard deviation below 3 of 255)")],
)
def test_black_and_uniform_frames_are_named_and_not_called_repeats(tmp_path: Path, grey: int, what: str) -> None:
    winter = save(tmp_path / "winter", season(0))
    frames = season(1)
    for number in (20, 21, 22):
        frames[number] = np.full_like(frames[number], grey)
    summer = save(tmp_path / "summer", frames)

    assert wrong(examined(winter, summer)) == [
        ("warning", "black frames", f"3 of 60 frames of summer are {what}: 020.png, 021.png, 022.png")
    ]


def test_a_repeated_frame_is_named_with_the_one_it_copies(tmp_path: Path) -> None:
    winter, summer = healthy(tmp_path)
    shutil.copy(summer / "011.png", summer / "012.png")
    shutil.copy(summer / "011.png", summer / "013.png")
    PillowImage.open(summer / "030.png").save(summer / "031.png", compress_level=0)  # other bytes, the same pixels

    assert wrong(examined(winter, summer)) == [
        (
            "warning",
            "repeated frames",
            "3 frames of summer are copies of another frame of summer, pixel by pixel: "
            "011.png = 012.png = 013.png, 030.png = 031.png",
        )
    ]


def test_a_season_that_was_put_into_the_folder_of_another_is_found_by_its_content(tmp_path: Path) -> None:
    winter = save(tmp_path / "winter", season(0))
    summer = save(tmp_path / "summer", season(0))

    ((level, check, text),) = wrong(examined(winter, summer))

    assert (level, check) == ("error", "shared frames")
    assert text.startswith("60 of 60 frames of summer are also in winter, pixel by pixel: 000.png = 000.png, ")


def test_two_reference_traverses_of_the_same_frames_are_an_error(tmp_path: Path) -> None:
    winter, summer = healthy(tmp_path)
    fall = save(tmp_path / "fall", season(0))

    found = wrong(examine(dataset_of([winter, fall], summer)))

    assert [(level, check) for level, check, _ in found] == [("error", "shared frames")]
    assert found[0][2].startswith("60 of 60 frames of winter are also in fall")


def test_a_single_query_that_is_also_a_reference_is_a_warning(tmp_path: Path) -> None:
    winter, summer = healthy(tmp_path)
    shutil.copy(winter / "044.png", summer / "044.png")

    assert wrong(examined(winter, summer)) == [
        (
            "warning",
            "shared frames",
            "1 of 60 frames of summer is also in winter, pixel by pixel: 044.png = 044.png",
        )
    ]


def test_a_name_that_a_list_repeats_is_no_repeated_frame(tmp_path: Path) -> None:
    winter, summer = healthy(tmp_path)
    listed = [*NAMES[:59], "010.png"]
    right = [[place] for place in [*range(PLACES - 1), 10]]

    assert not wrong(examined(winter, summer, query_names=listed, right=right))


def test_progress_is_reported_for_each_traverse_up_to_its_end(tmp_path: Path) -> None:
    heard: dict[str, float] = {}
    with listening(lambda stage, done: heard.__setitem__(stage, done)):
        examined(*healthy(tmp_path))

    assert heard == {"looking at winter": 1.0, "looking at summer": 1.0}
