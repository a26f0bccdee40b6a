"""Oxford RobotCar: a drive through Oxford in sun, in rain and at dusk, by published lists of its frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from vprbench.api import Dataset, Images, data_folder

from ..readers.frame_folders import root_folder
from ..readers.recipes import function_of
from ..readers.traverses import Evaluation, Traverses, check_recorded, dataset_of, every, right_places, split
from .calibration import STEREO_LEFT
from .lists import RECORDINGS, lists_folder, published_timestamps, vprsnn_timestamps
from .recordings import Recordings
from .repeats import remarks, steps_back

_DOWNLOAD = "oxford_robotcar"  # the folder of the download, whichever the list
_REGISTER = "https://mrgdatashare.robots.ox.ac.uk/register/"
_ALSO_TOLERATED = (1, 2, 3)  # places: neighbours in the lists are not always neighbours on the road


@dataclass(frozen=True)
class OxfordRobotcar:
    """Oxford RobotCar as `places` places, every `stride`-th row of a published list, one for each traverse.

    The k-th rows of all traverses show the same place. `references` are the traverses of the map (sun and rain if
    None). The `query_places` queries begin at place `first_query_place`; right is a place at most `tolerance` places
    away. With the protocol of VPRSNN that many places, chosen as its authors do, are in neither map nor queries
    instead. `image_list` says whose lists: those of VPRTempo (64154e5) are here, those of VPRSNN (d38f30c) are read
    from the folder `lists`, or `<root>/lists`. They name some images more than once, and some of their steps lead back
    in time: notes and protocol count both.

    Raw frames, at `<root>/<recording>/stereo/left/<timestamp>.png`, are demosaiced and undistorted when they are looked
    at, with the distortion table of robotcar-dataset-sdk (`calibration`, or `<root>/models`), and kept in
    `<root>/<recording>/demosaiced`, or below the folder `processed`. Frames that somebody processed are taken from
    there or from `<root>/<traverse>`. Raises MissingData for a missing root, frames, lists or distortion table,
    BadInput for other arguments and for files that are not what they should be.
    """

    name: str = "oxford_robotcar"
    root: str | None = None
    references: list[str] | None = None
    query: str = "dusk"
    stride: int = 7
    places: int = 450
    query_places: int = 360
    first_query_place: int = 90
    tolerance: int = 0
    protocol: Evaluation = "vprtempo"
    image_list: Literal["vprtempo", "vprsnn"] = "vprtempo"
    lists: str | None = None
    processed: str | None = None
    calibration: str | None = None

    def build(self) -> Dataset:
        """Return the dataset of these options, after a look at what is in the folders of the recordings."""
        chosen = ["sun", "rain"] if self.references is None else self.references
        check_recorded("Oxford RobotCar", "traverse", RECORDINGS, chosen, self.query)
        traverses = [*dict.fromkeys([*chosen, self.query])]
        layout = _layout(traverses, chosen[0])
        parts = split(self.protocol, self.places, self.first_query_place, self.query_places, self.tolerance)
        top, stamps = self._stamps(traverses, layout)
        names = {traverse: [f"{stamp}.png" for stamp in listed] for traverse, listed in stamps.items()}
        wanted = {**names, self.query: [names[self.query][place] for place in parts.needed_of_query()]}
        wanted |= {traverse: names[traverse] for traverse in chosen}  # the query may be one of them
        recordings = Recordings(top, wanted, STEREO_LEFT, layout, self.processed, self.calibration)

        def frames(shown: Sequence[tuple[str, int]]) -> Images:
            return recordings.images([(traverse, names[traverse][place]) for traverse, place in shown])

        used = {traverse: [stamps[traverse][place] for place in parts.mapped] for traverse in chosen}
        asked_stamps = [stamps[self.query][place] for place in parts.queried]
        rows = {**used, "queries": asked_stamps}
        positives = right_places(parts.queried, parts.mapped, self.tolerance)
        return dataset_of(
            self.name,
            parts,
            Traverses(chosen, self.query, frames, recordings.folders()),
            {
                "protocol": self.protocol,
                "image_list": self.image_list,
                "references": chosen,
                "query": self.query,
                "stride": self.stride,
                **parts.record(),
                "also_tolerance_places": [*_ALSO_TOLERATED],
                "repeated_images": {which: len(listed) - len(set(listed)) for which, listed in rows.items()},
                "steps_back_in_time": {which: steps_back(listed) for which, listed in rows.items()},
            },
            [*recordings.remarks(), *remarks(used, asked_stamps, positives, self.tolerance)],
        )

    def _stamps(self, traverses: Sequence[str], layout: str) -> tuple[Path, dict[str, list[int]]]:
        """Return the root, and the timestamps of each traverse, one a place; raises MissingData and BadInput."""
        if self.image_list == "vprtempo":  # arguments that its lists do not fit are refused before a look at the root
            stamps = self._one_a_place({traverse: published_timestamps(traverse) for traverse in traverses})
            return root_folder(self.name, self.root, "the traverses", layout, _DOWNLOAD), stamps
        top = root_folder(self.name, self.root, "the traverses", layout, _DOWNLOAD)
        folder = lists_folder(self.lists, [top, data_folder(_DOWNLOAD)])
        return top, self._one_a_place({traverse: vprsnn_timestamps(folder, traverse) for traverse in traverses})

    def _one_a_place(self, listed: Mapping[str, Sequence[int]]) -> dict[str, list[int]]:
        return {traverse: every(stamps, self.stride, self.places) for traverse, stamps in listed.items()}


oxford_robotcar = function_of(OxfordRobotcar)


def _layout(traverses: Sequence[str], first: str) -> str:
    """Return what a person has to do to have the frames of the traverses."""
    return (
        f"register at {_REGISTER} for stereo/left of {', '.join(RECORDINGS[traverse] for traverse in traverses)}, and "
        f"set dataset.root so that <root>/{RECORDINGS[first]}/stereo/left holds raw frames and <root>/models the "
        "distortion table of https://github.com/ori-mrg/robotcar-dataset-sdk, or that "
        f"<root>/{first}/<timestamp>.png are processed frames"
    )
