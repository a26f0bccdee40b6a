"""Nordland: a train ride through Norway in four seasons, by the published list of 27,592 frames."""

from __future__ import annotations

from pathlib import Path

import vprbench
from vprbench.images import Images
from vprbench.interface import BadInput, Dataset

from .frame_folders import check_frames, root_folder
from .traverses import Evaluation, check_recorded, dataset_of, recorded_split

SEASONS = ("spring", "summer", "fall", "winter")

_SOURCE = "Somayeh-h/Nordland on Hugging Face, one archive of 35,768 frames a season"


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
    protocol: Evaluation = "vprtempo",
) -> Dataset:
    """Return Nordland as `places` places, every `stride`-th name of the published list (VPRTempo 64154e5).

    `references` are the seasons of the map (spring and fall if None), each a traverse of the same places. The
    `query_places` queries begin at place `first_query_place`; right is a place at most `tolerance` places away. With
    the protocol of VPRSNN that many places, chosen as its authors do, are in neither map nor queries instead.
    `frame_multiple` keeps only names whose number it divides. `default_root` (relative to the checkout) stands in
    for a `root` of None where it exists; `source` says in messages where frames are to be had. Raises NotThere for a
    missing root or frames, BadInput for other arguments.
    """
    seasons = ["spring", "fall"] if references is None else references
    check_recorded("Nordland", "season", SEASONS, seasons, query)
    names = chosen_names(stride, places, frame_multiple)
    parts = recorded_split(protocol, places, first_query_place, query_places, tolerance)
    layout = f"get the frames from {source}, and set dataset.root so that <root>/{seasons[0]}/{names[0]} is the first"
    folder = root_folder(name, _beside_checkout(default_root) if root is None else root, "the seasons", layout)
    asked = [names[place] for place in parts.needed_of_query()]
    check_frames({folder / query: asked} | {folder / season: names for season in seasons}, layout)
    return dataset_of(
        name,
        parts,
        seasons,
        query,
        lambda shown: Images.from_files([folder / season / names[place] for season, place in shown]),
        {
            "protocol": protocol,
            "references": seasons,
            "query": query,
            "stride": stride,
            **parts.record(),
            "frame_multiple": frame_multiple,
        },
    )


def chosen_names(stride: int, places: int, frame_multiple: int) -> list[str]:
    """Return the file names of the places, in order; raises BadInput where the list does not hold that many."""
    if min(stride, places, frame_multiple) < 1:
        raise BadInput(
            f"dataset.stride={stride}, dataset.places={places}, dataset.frame_multiple={frame_multiple}: "
            "all have to be at least 1"
        )
    names = [f"images-{frame:05d}.png" for frame in published_frames() if frame % frame_multiple == 0]
    most = len(range(0, len(names), stride))
    if places > most:
        raise BadInput(f"dataset.places={places}: the list of {len(names)} names at stride {stride} has {most} places")
    return names[: places * stride : stride]


def published_frames() -> list[int]:
    """Return the 27,592 frame numbers of the list without tunnels and slow stretches (QVPR/VPRTempo 64154e5)."""
    runs = Path(__file__).with_name("nordland_runs.csv").read_text(encoding="ascii").split()
    bounds = [tuple(map(int, run.split(","))) for run in runs]
    return [frame for first, last in bounds for frame in range(first, last + 1)]


def _beside_checkout(default_root: str | None) -> str | None:
    """Return the folder of that path from the checkout, where it exists."""
    if default_root is None:
        return None
    default = Path(vprbench.__file__).resolve().parents[1] / default_root
    return str(default) if default.is_dir() else None
