"""Rendered frames, each rendered once and kept as a PNG in the cache folder."""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np

from vprbench.api.arrays import Image
from vprbench.api.decoding import read_image
from vprbench.api.images import Images
from vprbench.errors import BadInput
from vprbench.storage.atomic import replace_bytes
from vprbench.storage.folders import cache_folder

logger = logging.getLogger(__name__)

FORMAT = 2
_FOLDER = "VPRBENCH_FRAMES"  # environment variable


def cached_frames(images: Images, what: Mapping[str, Any]) -> Images:
    """Return images that are rendered once: each lies as a PNG in VPRBENCH_FRAMES, or in the user's cache folder.

    `what` (plain JSON) and the names decide about the frames: other values have a folder of their own. A missing or
    damaged file is rendered anew; where nothing can be written every frame is.
    """
    text = json.dumps({"format": FORMAT, "what": what, "names": images.names}, sort_keys=True)
    try:
        folder = cache_folder(_FOLDER, "frames") / hashlib.sha256(text.encode()).hexdigest()
        folder.mkdir(parents=True, exist_ok=True)
    except (BadInput, OSError) as error:
        logger.info("frames are not kept: %s", error)
        return images

    def read(number: int) -> Image:
        path = folder / f"{number:06d}.png"
        try:
            return read_image(path)
        except BadInput:
            image = images[number]
        _, png = cv2.imencode(".png", np.ascontiguousarray(image[:, :, ::-1]))  # OpenCV takes BGR
        try:
            replace_bytes(path, png.tobytes())
        except OSError as error:
            logger.info("%s is not kept: %s", path, error.strerror)
        return image

    return Images(read, images.names)
