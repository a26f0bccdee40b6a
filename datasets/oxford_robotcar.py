"""Oxford RobotCar: a drive through Oxford in sun, in rain and at dusk, by the published lists of 3369 frames."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from PIL import Image as PillowImage

from vprbench.images import Images
from vprbench.interface import BadInput, Dataset

from .frame_folders import check_frames, root_folder
from .traverses import Evaluation, check_recorded, dataset_of, recorded_split

#: When each traverse was recorded: its name in the RobotCar dataset.
RECORDINGS = {"sun": "2015-08-12-15-04-18", "rain": "2015-10-29-12-18-17", "dusk": "2014-11-21-16-07-03"}

_REGISTER = "https://mrgdatashare.robots.ox.ac.uk/register/"
_PROCESSED = "demosaiced"  # where VPRTempo's process_orc.py writes, below a recording's folder
_BAYER_MODES = ("L", "I", "I;16")


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
) -> Dataset:
    """Return Oxford RobotCar as `places` places, every `stride`-th row of the published lists (VPRTempo 64154e5).

    The k-th rows of all traverses show the same place. `references` are the traverses of the map (sun and rain if
    None). The `query_places` queries begin at place `first_query_place`; right is a place at most `tolerance` places
    away. With the protocol of VPRSNN that many places, chosen as its authors do, are in neither map nor queries
    instead. Frames are RGB, demosaiced and undistorted, at `<root>/<traverse>/<timestamp>.png` or
    `<root>/<recording>/demosaiced/<timestamp>.png`. The lists name some images more than once, and some of their steps
    lead back in time: the protocol counts both. Raises NotThere for a missing root or frames, BadInput for raw frames
    and for other arguments.
    """
    chosen = ["sun", "rain"] if references is None else references
    check_recorded("Oxford RobotCar", "traverse", RECORDINGS, chosen, query)
    stamps = {traverse: chosen_timestamps(traverse, stride, places) for traverse in [*chosen, query]}
    parts = recorded_split(protocol, places, first_query_place, query_places, tolerance)
    recordings = ", ".join(RECORDINGS[traverse] for traverse in stamps)
    layout = (
        f"register at {_REGISTER} for stereo/left of {recordings}, demosaic and undistort it (raw Bayer frames are not "
        f"accepted yet), and set dataset.root so that <root>/{chosen[0]}/{stamps[chosen[0]][0]}.png is the first"
    )
    top = root_folder(name, root, "the traverses", layout)
    folders = {traverse: _folder(top, traverse) for traverse in stamps}

    def paths(shown: Sequence[tuple[str, int]]) -> list[Path]:
        return [folders[traverse] / f"{stamps[traverse][place]}.png" for traverse, place in shown]

    asked = paths([(query, place) for place in parts.needed_of_query()])
    maps = {traverse: paths([(traverse, place) for place in range(places)]) for traverse in chosen}
    wanted = {query: asked} | maps
    check_frames({folders[traverse]: [path.name for path in wanted[traverse]] for traverse in wanted}, layout)
    for first in [*(frames[0] for frames in maps.values()), asked[0]]:
        _check_processed(first)
    used = {traverse: [stamps[traverse][place] for place in parts.mapped] for traverse in chosen}
    used["queries"] = [stamps[query][place] for place in parts.queried]
    return dataset_of(
        name,
        parts,
        chosen,
        query,
        lambda shown: Images.from_files(paths(shown)),
        {
            "protocol": protocol,
            "references": chosen,
            "query": query,
            "stride": stride,
            **parts.record(),
            "repeated_images": {which: len(rows) - len(set(rows)) for which, rows in used.items()},
            "steps_back_in_time": {which: sum(b < a for a, b in pairwise(rows)) for which, rows in used.items()},
        },
    )


def chosen_timestamps(traverse: str, stride: int, places: int) -> list[int]:
    """Return the microseconds that name the frames of the places, in order; raises BadInput where the list is short."""
    if min(stride, places) < 1:
        raise BadInput(f"dataset.stride={stride}, dataset.places={places}: both have to be at least 1")
    stamps = published_timestamps(traverse)
    most = len(range(0, len(stamps), stride))
    if places > most:
        raise BadInput(f"dataset.places={places}: the list of {len(stamps)} names at stride {stride} has {most} places")
    return stamps[: places * stride : stride]


def published_timestamps(traverse: str) -> list[int]:
    """Return the 3369 timestamps of a traverse in place order (QVPR/VPRTempo 64154e5), repeated where a frame is."""
    return [int(row) for row in Path(__file__).with_name(f"oxford_{traverse}.csv").read_text("ascii").split()]


def _folder(root: Path, traverse: str) -> Path:
    """Return where the frames of a traverse are, or should be."""
    recording = root / RECORDINGS[traverse] / _PROCESSED
    return recording if recording.is_dir() else root / traverse


def _check_processed(path: Path) -> None:
    """Raise BadInput for a frame as the camera recorded it: grey, one colour a pixel."""
    try:
        with PillowImage.open(path) as image:
            mode = image.mode
    except OSError as error:
        raise BadInput(f"{path} is no image that can be read: {error}") from error
    if mode in _BAYER_MODES:
        raise BadInput(
            f"{path} is grey, as raw Bayer frames are, which are not accepted yet: demosaic and undistort them all, "
            "as robotcar-dataset-sdk does, and set dataset.root to the folder of the colour ones"
        )
