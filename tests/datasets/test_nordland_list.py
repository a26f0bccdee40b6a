"""Nordland's list of frames without tunnels and slow stretches: byte for byte the published ones."""

import hashlib
from pathlib import Path

import pytest
from image_folders import REAL, needs_real_frames

from vprbench.datasets.nordland import chosen_names, published_frames

LINES = [f"images-{frame:05d}.png\n" for frame in published_frames()]


@pytest.mark.parametrize(
    ("text", "sha256"),
    [
        # The names of nordland-summer.csv joined by LF, without a final one.
        ("".join(LINES).removesuffix("\n"), "5f74d2dc7bb3ad4a452ec722c47482fb9d95ab3e0f15513b6ddf437157f914c2"),
        ("".join(LINES), "6b1dcf6a8ccf2860f5b473dce84941fff87735bcb94face0af66d14fba49ff73"),
        (
            "Image name,index\n" + "".join(f"{line[:-1]},{k}\n" for k, line in enumerate(LINES)),
            "790a59381bc5c96919b5043fc4dc8bdf7e720e8d3cb4b1d2d535b87b92a15ce6",
        ),
    ],
    ids=["names", "nordland_imageNames.txt of VPRSNN", "nordland-summer.csv of VPRTempo"],
)
def test_the_list_is_byte_for_byte_the_published_one(text, sha256):
    assert hashlib.sha256(text.encode()).hexdigest() == sha256


@pytest.mark.parametrize(
    ("place", "frame"), [(0, "00202"), (1, "00210"), (2, "00218"), (599, "07021"), (600, "07029"), (3299, "34160")]
)
def test_the_places_of_the_paper_are_every_eighth_name(place, frame):
    assert chosen_names(8, 3300, 1)[place] == f"images-{frame}.png"


@needs_real_frames
def test_the_names_divisible_by_ten_are_those_of_the_public_64x32_frames():
    listed = (REAL / "nordland_64x32" / "frames_clean_qvpr.txt").read_text().split()
    assert [Path(name).stem for name in chosen_names(1, 2761, 10)] == [Path(name).stem for name in listed]
