"""What a dataset plug-in has to return, and what becomes of errors of the disk while it looks for its files."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from vprbench.api.dataset import Dataset
from vprbench.errors import BadInput

_MOST_NAME_BYTES = 200  # file systems take 255, and other names are made of this one
_SHOWN = 150  # characters of a name in a message


@contextmanager
def disk_errors_told(name: str) -> Iterator[None]:
    """Turn an OSError, as for a path that no disk takes, into BadInput that names the path."""
    try:
        yield
    except OSError as error:
        told = f"{_shortened(str(error.filename))}: {error.strerror}" if error.filename and error.strerror else error
        raise BadInput(f"dataset {_shortened(name)} cannot be read ({told}): correct the path") from error


def require_dataset(made: Any, target: str) -> Dataset:
    """Return what `target` made; raises BadInput if it is no dataset of images, or its name is no folder's."""
    if not isinstance(made, Dataset):
        raise BadInput(f"{target} gave {type(made).__name__}; it has to return a Dataset")
    if len(os.fsencode(made.name)) > _MOST_NAME_BYTES:
        raise BadInput(
            f"dataset.name={_shortened(made.name)} has more than {_MOST_NAME_BYTES} bytes: give a shorter one, for its "
            "runs are stored in a folder of that name"
        )
    from vprbench.api.images import Images  # a list of names needs none

    for part, images in (("references", made.references), ("queries", made.queries)):
        if not isinstance(images, Images):
            raise BadInput(
                f"{target} gave {part} of type {type(images).__name__}; wanted is vprbench.api.images.Images, "
                "by Images.from_files(paths) or Images.from_arrays(arrays)"
            )
    return made


def _shortened(text: str) -> str:
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
