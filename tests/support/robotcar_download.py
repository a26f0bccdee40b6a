"""A RobotCar download in small: raw Bayer frames whose colours are known, and distortion tables."""

import numpy as np
from PIL import Image as PillowImage

from vprbench.datasets.oxford_robotcar.calibration import Camera
from vprbench.datasets.oxford_robotcar.lists import RECORDINGS, published_timestamps

SMALL = Camera(16, 12)
TABLE = "stereo_wide_left_distortion_lut.bin"
TINY = {"places": 4, "first_query_place": 1, "query_places": 3}
STAMPS = {traverse: published_timestamps(traverse)[:28:7] for traverse in RECORDINGS}
LEVEL = {"sun": 10, "rain": 60, "dusk": 110}
SITES = np.array([[1, 2], [0, 1]])  # GBRG: the channel that each of four neighbouring pixels records


def mosaic(image):
    """What the sensor records of a colour image: of each pixel the channel of its site."""
    height, width, _ = image.shape
    channel = np.tile(SITES, (height // 2 + 1, width // 2 + 1))[:height, :width]
    return np.take_along_axis(image, channel[:, :, None], axis=2)[:, :, 0]


def uniform(colour, camera=SMALL):
    return np.full((camera.height, camera.width, 3), colour, np.uint8)


def colour_of(traverse, place):
    return LEVEL[traverse] + place, LEVEL[traverse] + 20 + place, 200 - place


def grid(camera=SMALL):
    """Return x and y of every pixel, (height, width) each."""
    y, x = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    return x, y


def bent(camera=SMALL):
    """Return a distortion that bends straight lines and reaches beyond the frame's corners."""
    x, y = grid(camera)
    x, y = (x - 0.49 * camera.width) / camera.width, (y - 0.52 * camera.height) / camera.width
    shrunk = 1.15 - 0.5 * (x * x + y * y)
    return (x * shrunk + 0.503) * camera.width, (y * shrunk + 0.38) * camera.width


def write_table(folder, x, y):
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / TABLE
    path.write_bytes(np.stack([x.ravel(), y.ravel()]).astype("<f8").tobytes())
    return path


def raw_folder(root, traverse):
    return root / RECORDINGS[traverse] / "stereo" / "left"


def write_download(root):
    """Write raw frames of all traverses, each of one colour, and a table of no distortion; returns the root."""
    for traverse in RECORDINGS:
        folder = raw_folder(root, traverse)
        folder.mkdir(parents=True)
        for place, stamp in enumerate(STAMPS[traverse]):
            PillowImage.fromarray(mosaic(uniform(colour_of(traverse, place)))).save(folder / f"{stamp}.png")
    write_table(root / "models", *grid())
    return root
