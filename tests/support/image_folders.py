"""Folders of little images, and what is asked of every dataset that reads them."""

from pathlib import Path

import numpy as np
import pytest
from checkout import SHARED
from PIL import Image as PillowImage

from vprbench.datasets.image_list import image_list
from vprbench.errors import BadInput

REAL = SHARED / "data"
needs_real_frames = pytest.mark.real_frames


def fill(folder, names):
    """Put images of one pixel into a folder; the red level of the n-th is n."""
    for level, name in enumerate(names):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        PillowImage.new("RGB", (1, 1), (level, 0, 0)).save(path, "PNG")
    return folder


def numbered(count, suffix=".jpg"):
    return [f"{i}{suffix}" for i in range(count)]


def reds(images):
    return [int(image[0, 0, 0]) for image in images]


def listed(references, queries, **options):
    """Return the dataset of two tables beside the images 0.jpg to 39.jpg."""
    fill(Path(), numbered(40))
    for file, content in (("map.csv", references), ("asked.csv", queries)):
        Path(file).write_bytes(content if isinstance(content, bytes) else content.encode())
    return image_list(references=["map.csv"], queries="asked.csv", **options)


def rights(dataset):
    return [right.tolist() for right in dataset.positives]


def answer(make, *arguments, kind=BadInput, **options):
    with pytest.raises(BadInput) as error:
        make(*arguments, **options)
    assert type(error.value) is kind
    assert "\n" not in str(error.value)
    return str(error.value)


def used(dataset):
    """Return every file that the dataset says it takes from its folders; each has to be there."""
    files = [folder.path / name for folder in dataset.folders for name in folder.used]
    assert all(path.is_file() for path in files)
    return files


def lists(*rights_of):
    """Return the array of objects that VPR-Bench stores: a row [query, references] for each query."""
    rows = np.empty((len(rights_of), 2), dtype=object)
    for query, right in enumerate(rights_of):
        rows[query, 0], rows[query, 1] = query, right
    return rows
