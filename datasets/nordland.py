"""Nordland: a train ride through Norway in four seasons, by the published list of 27,592 frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from vprbench.api import BadInput, Dataset, Exif, FrameFolder, Images, Paths, decoding_of

from .readers.frame_folders import check_folders, find_folder, find_root
from .readers.traverses import Evaluation, check_traverses, make_dataset, split_places, take_every

SEASONS = ("spring", "summer", "fall", "winter")

#: Whose evaluation is followed: QVPR/VPRTempo and QVPR/VPRSNN, which query every 8th frame of the list, and those of
#: Patch-NetVLAD, VPR-datasets-downloader and VPR-Bench, whose maps hold all of it.
Protocol = Literal["vprtempo", "vprsnn", "patchnetvlad", "27k", "vprbench"]
Suffix = Literal[".png", ".jpg", ".jpeg"]

_SOURCE = "Somayeh-h/Nordland on Hugging Face, 35,768 frames a season (python -m vprbench fetch nordland)"
_SEASON_FRAMES = 35_768  # in QVPR's numbering, a frame a second
_OTHERS = "the partition of Olid et al., which numbers the frames in another way"
_WRONG_COUNTS = {24_570: f"a part of {_OTHERS}", 28_865: _OTHERS}
_PATCH_NETVLAD = (
    "Patch-NetVLAD names a tolerance of 10 frames; its published positions, frame i at (i, i) and a radius of 10, "
    "reach 7; right are here frames up to {} away"
)


def nordland(
    name: str = "nordland",
    root: str | None = None,
    references: list[str] | None = None,
    query: str = "summer",
    stride: int = 8,
    places: int = 3300,
    query_places: int = 2700,
    first_query_place: int = 600,
    tolerance: int = 0,
    frame_multiple: int = 1,
    default_root: str | None = None,
    source: str = _SOURCE,
    protocol: Protocol = "vprtempo",
    query_stride: int = 1,
    suffix: Suffix = ".png",
    download: str = "nordland",
    first_place: int = 0,
    exif: Exif = "ignore",
    levels: str | None = None,
) -> Dataset:
    """Return Nordland as `places` places, every `stride`-th name of the published list (VPRTempo 64154e5).

    `references` are the seasons of the map (spring and fall if None), each a traverse of the same places. The
    `query_places` queries begin at place `first_query_place`, `query_stride` places apart; right is a place at most
    `tolerance` places away. With the protocol of VPRSNN `first_query_place` places, chosen as its authors do, are in
    neither map nor queries instead. `frame_multiple` keeps only names whose number it divides. The first `first_place`
    places are left out of everything, and the others counted from 0. A `root` of None is `default_root` (relative to
    the checkout) if it exists, else the folder of the `download`; `source` says in messages where frames are to be had;
    `exif` and `levels` say how files are decoded (`decoding_of`). Raises MissingData for a missing root or frames,
    BadInput for other arguments.
    """
    seasons = ["spring", "fall"] if references is None else references
    check_traverses("Nordland", "season", SEASONS, seasons, query)
    names = chosen_names(stride, places, frame_multiple, suffix, first_place)
    evaluation: Evaluation = "vprsnn" if protocol == "vprsnn" else "vprtempo"
    parts = split_places(evaluation, places, first_query_place, query_places, tolerance, query_stride)
    used = {query: [names[place] for place in parts.list_needed_queries()]} | dict.fromkeys(seasons, names)
    first = f"<root>/{seasons[0]}/{names[0]}"
    layout = f"get the frames from {source}, and set dataset.root so that {first} is the first"
    top = find_root(name, root, "the seasons", layout, download, default_root, [*used])
    counts = _count_images(frame_multiple)
    folders = {
        season: FrameFolder(find_folder(top, season), tuple(wanted), counts, _WRONG_COUNTS)
        for season, wanted in used.items()
    }
    check_folders([*folders.values()], layout, "dataset.suffix")
    files = Paths.joined(Paths.below(folder.path, folder.used) for folder in folders.values())
    decoding, decoded = decoding_of(files, exif, levels, "dataset.")

    def frames(shown: Sequence[tuple[str, int]]) -> Images:
        return Images.from_files([folders[season].path / names[place] for season, place in shown], decoding)

    numbers = [int(name.removeprefix("images-").removesuffix(suffix)) for name in names]
    dataset = make_dataset(
        name,
        parts,
        seasons,
        query,
        frames,
        {
            "protocol": protocol,
            "references": seasons,
            "query": query,
            "stride": stride,
            **parts.describe(),
            "frame_multiple": frame_multiple,
            **({"first_place": first_place} if first_place else {}),
            **decoded,
        },
        folders=[*folders.values()],
        numbers=numbers,
        notes=[_PATCH_NETVLAD.format(tolerance)] if protocol == "patchnetvlad" else [],
    )
    return replace(dataset, place_numbers=first_place + parts.mapped) if first_place else dataset


def chosen_names(
    stride: int, places: int, frame_multiple: int, suffix: str = ".png", first_place: int = 0
) -> list[str]:
    """Return the file names of the places, in order; raises BadInput if the list has fewer."""
    if frame_multiple < 1 or first_place < 0:
        raise BadInput(
            f"dataset.frame_multiple={frame_multiple}, dataset.first_place={first_place}: give 1 or more, and 0 or more"
        )
    names = [f"images-{frame:05d}{suffix}" for frame in published_frames() if frame % frame_multiple == 0]
    return take_every(names[first_place * stride :], stride, places)


def published_frames() -> list[int]:
    """Return the 27,592 frame numbers of the list without tunnels and slow stretches (QVPR/VPRTempo 64154e5)."""
    runs = Path(__file__).with_name("nordland_runs.csv").read_text(encoding="ascii").split()
    bounds = [tuple(map(int, run.split(","))) for run in runs]
    return [frame for first, last in bounds for frame in range(first, last + 1)]


def _count_images(frame_multiple: int) -> tuple[int, ...]:
    """Return how many images a whole season may hold: all or the listed ones, of every frame or of the multiples."""
    listed = published_frames()
    multiples = sum(frame % frame_multiple == 0 for frame in listed)
    return tuple(dict.fromkeys((_SEASON_FRAMES // frame_multiple, multiples, _SEASON_FRAMES, len(listed))))
