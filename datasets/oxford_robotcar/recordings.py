"""Where the frames of a traverse are: processed by somebody else, raw as downloaded, or processed here before."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from vprbench.api import BadInput, FrameFolder, Images

from ..readers.frame_folders import check_folders, files_in
from .calibration import Camera, find_calibration, opened, read_calibration, read_raw
from .kept import PUBLISHED, KeptFrames, is_made_with, recorded_calibration
from .lists import RECORDINGS

_PROCESSED = "demosaiced"  # where VPRTempo's process_orc.py writes, below a recording's folder
_OWN = "vprbench"  # where we write inside a folder that holds frames of somebody else
_RAW = Path("stereo", "left")
_BAYER_MODES = ("L", "I", "I;16")


@dataclass(frozen=True)
class Recording:
    """The folder that the frames of a traverse are read from."""

    folder: Path
    kept: Path | None = None  # of raw frames: where the processed ones go
    remark: str = ""  # how an earlier run or somebody else processed them


class Recordings:
    """The frames of several traverses, each found where it is."""

    def __init__(
        self,
        root: Path,
        wanted: Mapping[str, Sequence[str]],
        camera: Camera,
        layout: str,
        processed: str | None,
        calibration: str | None,
    ) -> None:
        """Find the file names wanted of each traverse.

        `processed` is a folder for processed frames outside the root, `calibration` the distortion table or its
        folder. Preference: complete third-party frames, then raw frames, then frames processed by an earlier run.
        Raises MissingData, with `layout`, for missing frames and for raw frames without a distortion table, BadInput if
        the first frame of a traverse is not what it should be.
        """
        outside = None if processed is None else Path(processed).expanduser()
        self._wanted = {traverse: tuple(dict.fromkeys(names)) for traverse, names in wanted.items()}
        self._found = {traverse: _find(root, traverse, names, outside) for traverse, names in self._wanted.items()}
        check_folders(self.folders(), layout)
        raw = {one.folder: one.kept for one in self._found.values() if one.kept is not None}
        for traverse, one in self._found.items():
            first = one.folder / self._wanted[traverse][0]
            if one.folder in raw:
                read_raw(first, camera)
            else:
                _check_processed(first)
        self._calibration = read_calibration(find_calibration(root, calibration), camera) if raw else None
        self._kept = None if self._calibration is None else KeptFrames(self._calibration, raw)

    def images(self, shown: Sequence[tuple[str, str]]) -> Images:
        """Return the images of (traverse, file name), processed when they are looked at."""
        paths = [self._found[traverse].folder / name for traverse, name in shown]
        return Images.from_files(paths, PUBLISHED) if self._kept is None else self._kept.images(paths)

    def folders(self) -> tuple[FrameFolder, ...]:
        """Return where the frames are read from, with the names that are wanted."""
        return tuple(FrameFolder(one.folder, self._wanted[traverse]) for traverse, one in self._found.items())

    def remarks(self) -> Iterator[str]:
        """Yield how the frames were processed, for a reader of results."""
        said = {traverse: self._remark(one) for traverse, one in self._found.items()}
        for remark in dict.fromkeys(said.values()):
            yield f"frames of {', '.join(name for name, own in said.items() if own == remark)}: {remark}"

    def _remark(self, recording: Recording) -> str:
        if recording.kept is None or self._calibration is None:
            return recording.remark
        return f"demosaiced and undistorted here, {_with_table(self._calibration.sha256)}"


def _find(root: Path, traverse: str, names: Sequence[str], outside: Path | None) -> Recording:
    """Return where the frames of a traverse are, or should be."""
    recording = root / RECORDINGS[traverse]
    beside = recording / _PROCESSED
    kept = beside if outside is None else outside / RECORDINGS[traverse]
    places = [*dict.fromkeys([kept, kept / _OWN, beside, beside / _OWN, root / traverse])]
    for folder in places:
        if recorded_calibration(folder) is None and _has(folder, names):
            return Recording(folder, remark="demosaiced and undistorted by somebody else, how is not recorded")
    raw = recording / _RAW
    if _has(raw, names):
        return Recording(raw, kept / _OWN if _is_somebody_elses(kept) else kept)
    for folder in places:
        made_with = recorded_calibration(folder)
        if made_with is not None and _has(folder, names):
            _require_one_table(folder, made_with, names, raw)
            return Recording(folder, remark=f"demosaiced and undistorted here before, {_with_table(made_with)}")
    if raw.is_dir():
        return Recording(raw)
    return Recording(beside if beside.is_dir() else root / traverse)


def _require_one_table(folder: Path, made_with: str, names: Sequence[str], raw: Path) -> None:
    """Raise BadInput if some of our frames were made in another way than the last frames of their folder."""
    others = [name for name in names if not is_made_with(folder / name, made_with)]
    if others:
        raise BadInput(
            f"{len(others)} of {len(names)} frames in {folder} are damaged, or were made with another distortion table "
            f"than the last ones (the first is {others[0]}), and the raw frames they are made of are not in {raw}: put "
            "those there"
        )


def _with_table(sha256: str) -> str:
    return f"with the distortion table {sha256[:8]}"


def _has(folder: Path, names: Sequence[str]) -> bool:
    """Tell whether a folder holds all of the files."""
    return folder.is_dir() and {*names} <= files_in(folder)


def _is_somebody_elses(folder: Path) -> bool:
    """Tell whether a folder holds frames, and none of them ours."""
    return recorded_calibration(folder) is None and folder.is_dir() and any(folder.glob("[!.]*.png"))


def _check_processed(path: Path) -> None:
    """Raise BadInput for a frame that is no image, or grey, as the camera records it: one colour a pixel."""
    with opened(path) as image:
        mode = image.mode
    if mode in _BAYER_MODES:
        raise BadInput(
            f"{path} is grey, as raw Bayer frames are, and not demosaiced: put raw frames at "
            f"<root>/<recording>/{_RAW}, where they are demosaiced and undistorted, or colour ones here"
        )
