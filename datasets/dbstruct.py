"""The dbStruct .mat files of NetVLAD's authors: names and positions of database and query images."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Unpack

import numpy as np

from vprbench.api import BadInput, Dataset, MatFileError, MissingData, read_mat

from .readers.file_dataset import FileOptions, dataset_of_files
from .readers.frame_folders import find_root
from .readers.image_files import find_listed
from .readers.positions import Positions, WithoutPosition, match_positions, require_metres

_NAMES, _UTM, _QUERY_NAMES, _QUERY_UTM = 1, 2, 3, 4  # fields by position, as Relja/netvlad writes them

_LAYOUT = (
    "the .mat files are in netvlad_v100_datasets.tar.gz (www.di.ens.fr/willow/research/netvlad), for the images of "
    "Pittsburgh their authors have to be asked; set dataset.root to the folder that the names start from and "
    "dataset.mat to the file"
)


def dbstruct(
    name: str = "dbstruct",
    root: str | None = None,
    mat: str | None = None,
    database_folder: str = "",
    query_folder: str = "",
    database_suffix: str | None = None,
    radius_metres: float = 25.0,
    without_position: WithoutPosition = "error",
    **options: Unpack[FileOptions],
) -> Dataset:
    """Return the images that the structure `dbStruct` in `mat` (a path from `root`) names, in its order.

    Database names start from `<root>/<database_folder>`, query names from `<root>/<query_folder>` (queries_real for
    Pittsburgh). `database_suffix` replaces that of the database names, for Tokyo 24/7 says .jpg and holds .png. Every
    database image is a place; right is what lies within `radius_metres` of a query, the radius included.
    `without_position` is that of `match_positions`. Raises MissingData for missing files, BadInput for a file without
    such a structure.
    """
    top = find_root(name, root, "the images that the .mat file names", _LAYOUT)
    if mat is None:
        raise MissingData(f"dataset.mat is not set: {_LAYOUT}")
    file = top / Path(mat).expanduser()
    fields = _read_fields(file)
    database = [top / database_folder / entry for entry in _read_names(file, fields, _NAMES)]
    if database_suffix is not None:
        database = [path.with_suffix(database_suffix) for path in database]
    queries = [top / query_folder / entry for entry in _read_names(file, fields, _QUERY_NAMES)]
    advice = "set dataset.root, dataset.database_folder or dataset.database_suffix"
    map_files = find_listed(database, f"the database of {file.name}", advice)
    query_files = find_listed(queries, f"the queries of {file.name}", "set dataset.root or dataset.query_folder")
    known, sought = (
        Positions(files, require_metres(f"field {at + 1} of dbStruct in {file}", np.asarray(fields[at]).T, len(files)))
        for files, at in ((map_files, _UTM), (query_files, _QUERY_UTM))
    )
    return dataset_of_files(
        name,
        map_files,
        query_files,
        match_positions([known], sought, radius_metres, without_position),
        {
            "protocol": "dbstruct",
            "mat": file.name,
            "database_folder": database_folder,
            "query_folder": query_folder,
            "database_suffix": database_suffix,
            "radius_metres": radius_metres,
        },
        **options,
    )


def _read_fields(file: Path) -> tuple[Any, ...]:
    """Return the fields of dbStruct, by position; raises MissingData or BadInput."""
    if not file.is_file():
        raise MissingData(f"dataset.mat: {file} is no file; {_LAYOUT}")
    try:
        content = read_mat(file)
    except MatFileError as error:
        raise BadInput(f"{file} cannot be read as a .mat file ({error}): get it from its source again") from error
    fields = content.get("dbStruct")
    if not isinstance(fields, dict) or len(fields) <= _QUERY_UTM:
        held = ", ".join(sorted(content)) or "nothing"
        raise BadInput(
            f"{file} holds {held}, but no dbStruct with names and positions: set dataset.mat to another file"
        )
    return tuple(fields.values())


def _read_names(file: Path, fields: tuple[Any, ...], position: int) -> list[str]:
    """Return the file names in a field, a cell array of words or a matrix of characters."""
    entries = [np.asarray(entry) for entry in np.asarray(fields[position]).ravel()]
    if not entries or not all(entry.size == 1 and entry.dtype.kind == "U" for entry in entries):
        raise BadInput(f"field {position + 1} of dbStruct in {file} holds no list of file names")
    return [str(entry.item()).rstrip() for entry in entries]
