"""Where the frames of a traverse are: processed by somebody else, or raw as downloaded and processed here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from vprbench.api import BadInput, Decoding, FrameFolder, Image, Images, Paths, cached_frames

from ..readers.frame_folders import check_folders, list_files
from .calibration import VERSION, Calibration, find_calibration, read_calibration, read_pixels, read_raw, undistort
from .lists import RECORDINGS

_PROCESSED = "demosaiced"  # where VPRTempo's process_orc.py writes, below a recording's folder
_RAW = Path("stereo", "left")
_BAYER_MODES = ("L", "I", "I;16")
_PUBLISHED = Decoding(exif="ignore")


class Recordings:
    """The frames of several traverses, each found where it is.

    Raw frames are demosaiced and undistorted when they are first looked at, and kept in the cache of rendered frames.
    """

    def __init__(
        self,
        root: Path,
        wanted: Mapping[str, Sequence[str]],
        listed: Mapping[str, Sequence[str]],
        layout: str,
        calibration: str | None,
    ) -> None:
        """Find the file names wanted of each traverse; those of `listed` share a folder of processed frames.

        `calibration` is the distortion table or its folder. Complete third-party frames come before raw ones. Raises
        MissingData, with `layout`, for missing frames and for raw frames without a distortion table, BadInput if the
        first frame of a traverse is not as it should be.
        """
        distinct = {traverse: tuple(dict.fromkeys(names)) for traverse, names in wanted.items()}
        self._folders = {
            traverse: FrameFolder(_find_folder(root, traverse, names), names) for traverse, names in distinct.items()
        }
        check_folders(self.folders(), layout)
        self._processed: dict[str, tuple[Images, dict[str, int]]] = {}  # of raw frames, with the number of each name
        self._made_with = b""
        raw = [traverse for traverse, folder in self._folders.items() if folder.path == _raw_folder(root, traverse)]
        table = read_calibration(find_calibration(root, calibration)) if raw else None
        for traverse, folder in self._folders.items():
            first = folder.path / folder.used[0]
            if table is None or traverse not in raw:
                _check_processed(first)
                continue
            read_raw(first)
            self._made_with = f"{table.sha256} {VERSION}".encode()
            numbers = {name: number for number, name in enumerate(dict.fromkeys(listed[traverse]))}
            self._processed[traverse] = _process_frames(folder.path, [*numbers], table), numbers

    def images(self, shown: Sequence[tuple[str, str]]) -> Images:
        """Return the images of (traverse, file name)."""
        files = Images.from_files([self._folders[traverse].path / name for traverse, name in shown], _PUBLISHED)
        if not self._processed:
            return files

        def read(i: int) -> Image:
            traverse, name = shown[i]
            if traverse not in self._processed:
                return files[i]
            images, numbers = self._processed[traverse]
            return images[numbers[name]]

        def stamp(i: int) -> bytes:
            return self._made_with if shown[i][0] in self._processed else b""

        return Images(read, files.names, files=files.files, stamp=stamp, content=stamp)

    def folders(self) -> tuple[FrameFolder, ...]:
        """Return where the frames are read from, with the names that are wanted."""
        return tuple(self._folders.values())

    def notes(self) -> list[str]:
        """Return how the frames were processed, for a reader of results."""
        table = self._made_with[:8].decode()
        ours, theirs = [*self._processed], [name for name in self._folders if name not in self._processed]
        return [
            f"frames of {', '.join(names)}: demosaiced and undistorted {how}"
            for names, how in (
                (ours, f"here, with the distortion table {table}"),
                (theirs, "by somebody else, how is not recorded"),
            )
            if names
        ]


def _process_frames(folder: Path, names: Sequence[str], table: Calibration) -> Images:
    """Return the raw frames of a folder demosaiced and undistorted, each when it is first looked at."""
    files = Paths.below(folder, names)
    made = Images(lambda i: undistort(read_raw(files[i]), table), files.names)
    what = {"raw": str(folder.resolve()), "calibration": table.sha256, "version": VERSION}
    return cached_frames(made, what)


def _raw_folder(root: Path, traverse: str) -> Path:
    return root / RECORDINGS[traverse] / _RAW


def _find_folder(root: Path, traverse: str, names: Sequence[str]) -> Path:
    """Return the first folder that has all frames of a traverse, else one that should have them."""
    raw = _raw_folder(root, traverse)
    places = [root / RECORDINGS[traverse] / _PROCESSED, root / traverse, raw]
    whole = (folder for folder in places if folder.is_dir() and {*names} <= list_files(folder))
    return next(whole, raw if raw.is_dir() else next(filter(Path.is_dir, places), root / traverse))


def _check_processed(path: Path) -> None:
    """Raise BadInput for a frame that is no image, or grey, as the camera records it: one colour a pixel."""
    _, mode = read_pixels(path)
    if mode in _BAYER_MODES:
        raise BadInput(
            f"{path} is grey, as raw Bayer frames are, and not demosaiced: put raw frames at "
            f"<root>/<recording>/{_RAW}, where they are demosaiced and undistorted, or colour ones here"
        )
