"""Oxford RobotCar: a drive through Oxford in sun, in rain and at dusk, by published lists of its frames."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from vprbench.api import Dataset, Images, data_folder

from ..frame_folders import root_folder
from ..traverses import Evaluation, check_recorded, dataset_of, recorded_split, right_places
from .calibration import STEREO_LEFT
from .lists import RECORDINGS, every, lists_folder, published_timestamps, vprsnn_timestamps
from .recordings import Recordings
from .repeats import remarks, steps_back

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
    processed: str | None = None,
    calibration: str | None = None,
) -> Dataset:
    """Return Oxford RobotCar as `places` places, every `stride`-th row of a published list, one for each traverse.

    The k-th rows of all traverses show the same place. `references` are the traverses of the map (sun and rain if
    None). The `query_places` queries begin at place `first_query_place`; right is a place at most `tolerance` places
    away. With the protocol of VPRSNN that many places, chosen as its authors do, are in neither map nor queries
    instead. `image_list` says whose lists: those of VPRTempo (64154e5) are here, those of VPRSNN (d38f30c) are read
    from the folder `lists`, or `<root>/lists`. They name some images more than once, and some of their steps lead back
    in time: notes and protocol count both.

    Raw frames, at `<root>/<recording>/stereo/left/<timestamp>.png`, are demosaiced and undistorted when they are looked
    at, with the distortion table of robotcar-dataset-sdk (`calibration`, or `<root>/models`), and kept in
    `<root>/<recording>/demosaiced`, or below the folder `processed`. Frames that somebody processed are taken from
    there or from `<root>/<traverse>`. Raises NotThere for a missing root, frames, lists or distortion table, BadInput
    for other arguments and for files that are not what they should be.
    """
    chosen = ["sun", "rain"] if references is None else references
    check_recorded("Oxford RobotCar", "traverse", RECORDINGS, chosen, query)
    traverses = [*dict.fromkeys([*chosen, query])]
    layout = (
        f"register at {_REGISTER} for stereo/left of {', '.join(RECORDINGS[traverse] for traverse in traverses)}, and "
        f"set dataset.root so that <root>/{RECORDINGS[chosen[0]]}/stereo/left holds raw frames and <root>/models the "
        "distortion table of https://github.com/ori-mrg/robotcar-dataset-sdk, or that "
        f"<root>/{chosen[0]}/<timestamp>.png are processed frames"
    )
    parts = recorded_split(protocol, places, first_query_place, query_places, tolerance)
    if image_list == "vprtempo":  # arguments that its lists do not fit are refused before anything is looked for
        stamps = {traverse: every(published_timestamps(traverse), stride, places) for traverse in traverses}
    top = root_folder(name, root, "the traverses", layout, _DOWNLOAD)
    if image_list != "vprtempo":
        folder = lists_folder(lists, [top, data_folder(_DOWNLOAD)])
        stamps = {traverse: every(vprsnn_timestamps(folder, traverse), stride, places) for traverse in traverses}

    file_names = {traverse: [f"{stamp}.png" for stamp in listed] for traverse, listed in stamps.items()}
    wanted = {**file_names, query: [file_names[query][place] for place in parts.needed_of_query()]}
    wanted |= {traverse: file_names[traverse] for traverse in chosen}  # the query may be one of them
    recordings = Recordings(top, wanted, STEREO_LEFT, layout, processed, calibration)

    def frames(shown: Sequence[tuple[str, int]]) -> Images:
        return recordings.images([(traverse, file_names[traverse][place]) for traverse, place in shown])

    used = {traverse: [stamps[traverse][place] for place in parts.mapped] for traverse in chosen}
    asked = [stamps[query][place] for place in parts.queried]
    rows = {**used, "queries": asked}
    positives = right_places(parts.queried, parts.mapped, tolerance)
    return dataset_of(
        name,
        parts,
        chosen,
        query,
        frames,
        {
            "protocol": protocol,
            "image_list": image_list,
            "references": chosen,
            "query": query,
            "stride": stride,
            **parts.record(),
            "also_tolerance_places": [*_ALSO_TOLERATED],
            "repeated_images": {which: len(listed) - len(set(listed)) for which, listed in rows.items()},
            "steps_back_in_time": {which: steps_back(listed) for which, listed in rows.items()},
        },
        recordings.folders(),
        [*recordings.remarks(), *remarks(used, asked, positives, tolerance)],
    )
