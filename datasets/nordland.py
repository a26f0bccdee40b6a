"""Nordland: a train ride through Norway in four seasons, by the published list of 27,592 frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

import vprbench
from vprbench.images import Images
from vprbench.interface import BadInput, Dataset

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
) -> Dataset:
    """Return Nordland as `places` places, every `stride`-th name of the published list (VPRTempo 64154e5).

    `references` are the seasons of the map (spring and fall if None), each a traverse of the same places. The
    `query_places` queries begin at place `first_query_place`; right is a place at most `tolerance` places away.
    `frame_multiple` keeps only names whose number it divides. `default_root` (relative to the checkout) stands in
    for a `root` of None where it exists; `source` says in messages where frames are to be had. Raises BadInput for a
    missing root or frames.
    """
    seasons = ["spring", "fall"] if references is None else references
    for option, season in [*(("references", season) for season in seasons), ("query", query)]:
        if season not in SEASONS:
            raise BadInput(f"dataset.{option}={season}: Nordland has {', '.join(SEASONS)}")
    if not seasons or len(set(seasons)) < len(seasons):
        raise BadInput(f"dataset.references={seasons}: name at least one season, each once")
    names = chosen_names(stride, places, frame_multiple)
    last = first_query_place + query_places
    if query_places < 1 or first_query_place < 0 or last > places:
        raise BadInput(
            f"dataset.first_query_place={first_query_place} and dataset.query_places={query_places} ask for places "
            f"{first_query_place} to {last - 1}; wanted are one or more of the places 0 to {places - 1}"
        )
    if tolerance < 0:
        raise BadInput(f"dataset.tolerance={tolerance}: give 0 or more places")
    asked = names[first_query_place:last]
    layout = f"get the frames from {source}, and set dataset.root so that <root>/{seasons[0]}/{names[0]} is the first"
    folder = _root(name, root, default_root, layout)
    _check_frames(folder, {query: asked} | dict.fromkeys(seasons, names), layout)
    return Dataset(
        name=name,
        references=Images.from_files([folder / season / frame for season in seasons for frame in names]),
        places=np.tile(np.arange(places), len(seasons)),
        queries=Images.from_files([folder / query / frame for frame in asked]),
        positives=tuple(
            np.arange(max(0, place - tolerance), min(places, place + tolerance + 1))
            for place in range(first_query_place, last)
        ),
        protocol={
            "references": seasons,
            "query": query,
            "stride": stride,
            "places": places,
            "query_places": query_places,
            "first_query_place": first_query_place,
            "tolerance_places": tolerance,
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


def _root(name: str, root: str | None, default_root: str | None, layout: str) -> Path:
    """Return the folder that holds the seasons; raises BadInput with where to get them."""
    if root is None and default_root is not None:
        default = Path(vprbench.__file__).resolve().parents[1] / default_root
        if default.is_dir():
            return default
    if root is None:
        raise BadInput(f"dataset.root is not set: {name} needs the folder that holds the seasons; {layout}")
    folder = Path(root).expanduser()
    if not folder.is_dir():
        raise BadInput(f"dataset.root={root} is no folder: {name} needs the one that holds the seasons; {layout}")
    return folder


def _check_frames(folder: Path, wanted: Mapping[str, Sequence[str]], layout: str) -> None:
    """Raise BadInput for a season that is missing or lacks frames."""
    for season, names in wanted.items():
        if not (folder / season).is_dir():
            raise BadInput(f"{folder / season} does not exist: {layout}")
        present = {entry.name for entry in (folder / season).iterdir()}
        missing = [name for name in names if name not in present]
        if missing:
            raise BadInput(
                f"{missing[0]} is missing from {folder / season} ({len(missing)} of {len(names)} expected frames are "
                f"missing, {len(present)} files are there): {layout}"
            )
