"""Oxford RobotCar: a drive through Oxford in sun, in rain and at dusk, by published lists of its frames."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from vprbench.api import Dataset, Images, data_folder

from ..readers.frame_folders import find_root
from ..readers.traverses import Evaluation, check_traverses, make_dataset, match_numbers, split_places, take_every
from .lists import RECORDINGS, count_steps_back, describe_list, published_timestamps, vprsnn_timestamps
from .recordings import Recordings

_DOWNLOAD = "oxford_robotcar"  # the folder of the download, whichever the list
_REGISTER = "https://mrgdatashare.robots.ox.ac.uk/register/"
_ALSO_TOLERATED = (1, 2, 3)  # places: neighbours in the lists are not always neighbours on the road


def oxford_robotcar(
    name: str = "oxford_robotcar",
    root: str | None = None,
    references: list[str] | None = None,
    query: str = "dusk",
    stride: int = 7,
    places: int = 450,
    query_places: int = 360,
    first_query_place: int = 90,
    tolerance: int = 0,
    protocol: Evaluation = "vprtempo",
    image_list: Literal["vprtempo", "vprsnn"] = "vprtempo",
    lists: str | None = None,
    calibration: str | None = None,
) -> Dataset:
    """Return Oxford RobotCar as `places` places, every `stride`-th row of a published list, one for each traverse.

    The k-th rows of all traverses show the same place. `references` are the traverses of the map (sun and rain if
    None). The `query_places` queries begin at place `first_query_place`; right is a place at most `tolerance` places
    away. With the protocol of VPRSNN that many places, chosen as its authors do, are in neither map nor queries
    instead. `image_list` says whose lists: those of VPRTempo (64154e5) are here, those of VPRSNN (d38f30c) are read
    from the folder `lists`, or `<root>/lists`. They name some images more than once, and some of their steps lead back
    in time: notes and protocol count both.

    Frames that somebody processed are taken from `<root>/<recording>/demosaiced` or `<root>/<traverse>`. Raw frames, at
    `<root>/<recording>/stereo/left/<timestamp>.png`, are demosaiced and undistorted when they are first looked at, with
    the distortion table of robotcar-dataset-sdk (`calibration`, or `<root>/models`), and kept in the cache of rendered
    frames. Raises MissingData for a missing root, frames, lists or distortion table, BadInput for other arguments and
    for files that are not what they should be.
    """
    mapped = ["sun", "rain"] if references is None else references
    check_traverses("Oxford RobotCar", "traverse", RECORDINGS, mapped, query)
    traverses = [*dict.fromkeys([*mapped, query])]
    layout = _describe_layout(traverses, mapped[0])
    parts = split_places(protocol, places, first_query_place, query_places, tolerance)
    top = find_root(name, root, "the traverses", layout, _DOWNLOAD)
    folder = _find_lists(top, lists)
    listed = {
        traverse: published_timestamps(traverse) if image_list == "vprtempo" else vprsnn_timestamps(folder, traverse)
        for traverse in traverses
    }
    stamps = {traverse: take_every(rows, stride, places) for traverse, rows in listed.items()}
    files = {traverse: [f"{stamp}.png" for stamp in rows] for traverse, rows in stamps.items()}
    wanted = {**files, query: [files[query][place] for place in parts.list_needed_queries()]}
    wanted |= {traverse: files[traverse] for traverse in mapped}  # the query may be one of them
    all_files = {traverse: [f"{stamp}.png" for stamp in rows] for traverse, rows in listed.items()}
    recordings = Recordings(top, wanted, all_files, layout, calibration)

    def frames(shown: Sequence[tuple[str, int]]) -> Images:
        return recordings.images([(traverse, files[traverse][place]) for traverse, place in shown])

    used = {traverse: [stamps[traverse][place] for place in parts.mapped] for traverse in mapped}
    query_stamps = [stamps[query][place] for place in parts.queried]
    rows = {**used, "queries": query_stamps}
    positives = match_numbers(parts.queried, parts.mapped, tolerance)
    return make_dataset(
        name,
        parts,
        mapped,
        query,
        frames,
        {
            "protocol": protocol,
            "image_list": image_list,
            "references": mapped,
            "query": query,
            "stride": stride,
            **parts.describe(),
            "also_tolerance_places": [*_ALSO_TOLERATED],
            "repeated_images": {which: len(stamps) - len(set(stamps)) for which, stamps in rows.items()},
            "steps_back_in_time": {which: count_steps_back(stamps) for which, stamps in rows.items()},
        },
        folders=recordings.folders(),
        notes=[*recordings.notes(), *describe_list(used, query_stamps, positives, tolerance)],
    )


def _find_lists(root: Path, given: str | None) -> Path:
    """Return the folder of VPRSNN's lists: `given`, else that of the root, or of the download."""
    if given is not None:
        return Path(given).expanduser()
    candidates = [root / "lists", data_folder(_DOWNLOAD) / "lists"]
    return next(filter(Path.is_dir, candidates), candidates[0])


def _describe_layout(traverses: Sequence[str], first: str) -> str:
    """Return what a person has to do to have the frames of the traverses."""
    return (
        f"register at {_REGISTER} for stereo/left of {', '.join(RECORDINGS[traverse] for traverse in traverses)}, and "
        f"set dataset.root so that <root>/{RECORDINGS[first]}/stereo/left holds raw frames and <root>/models the "
        "distortion table of https://github.com/ori-mrg/robotcar-dataset-sdk, or that "
        f"<root>/{first}/<timestamp>.png are processed frames"
    )
