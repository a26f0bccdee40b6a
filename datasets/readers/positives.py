"""The right places of each query, read from lists of places, from a matrix, or from an .npz file that holds one."""

from __future__ import annotations

import lzma
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array, issparse

from vprbench.api import BadInput, MissingData

Positives = tuple[npt.NDArray[np.int64], ...]

_AXES = ("queries", "places")
# RuntimeError of zipfile: encrypted, or compressed in a way that it does not know.
_ERRORS = (OSError, RuntimeError, ValueError, EOFError, MemoryError, zipfile.BadZipFile, zlib.error, lzma.LZMAError)
_SHOWN = 10  # names in a message


def read_positives(positives: Any, n_queries: int, n_places: int) -> Positives:
    """Return the right places of each query, ascending.

    Args:
        positives: a place or a list of places for each query, or a matrix (n_queries, n_places) of booleans or of 0
            and 1, dense or sparse.
        n_queries: the number of queries.
        n_places: the number of places.

    Raises:
        BadInput: the positives fit neither form, or both.
    """
    try:
        table = positives if issparse(positives) else np.asarray(positives)
    except ValueError:  # lists of unequal length
        table = np.empty(0, object)
    if issparse(table) or _is_matrix(table, n_queries, n_places):
        return read_matrix("positives", table, (n_queries, n_places), _AXES)
    rows = table if table.ndim == 2 else positives
    if isinstance(positives, Mapping) or len(rows) != n_queries:
        raise BadInput(f"positives: right places of {len(rows)} queries came, and there are {n_queries}: give a list")
    found = []
    for query, right in enumerate(rows):
        row = np.asarray(right)
        if row.dtype == bool and row.shape == (n_places,):
            row = np.flatnonzero(row)
        elif row.size and row.dtype.kind not in "iu":
            raise BadInput(
                f"positives of query {query}: {right!r} came; wanted numbers of places, or {n_places} booleans"
            )
        found.append(np.unique(row.reshape(-1).astype(np.int64)))
    return tuple(found)


def read_matrix(
    named: str, matrix: Any, shape: tuple[int, int], axes: tuple[str, str], of_columns: bool = False
) -> Positives:
    """Return which columns are right in each row of a matrix, dense or sparse, ascending; or which rows in each column.

    Raises BadInput, for the matrix `named`, unless it has that shape and holds nothing but 0 and 1.
    """
    if matrix.shape != shape:
        turned = " (it is transposed)" if matrix.shape == shape[::-1] else ""
        raise BadInput(
            f"{named} has the shape {matrix.shape}{turned}; wanted is {shape}, {axes[0]} by {axes[1]}, for the images "
            "that are there"
        )
    rows = csr_array(matrix, copy=True) if matrix.dtype.kind in "buif" else None
    if rows is not None:
        rows.sum_duplicates()
    if rows is None or not np.isin(rows.data, (0, 1)).all():
        raise BadInput(f"{named} holds {matrix.dtype} values other than 0 and 1: yes and no are wanted")
    rows.eliminate_zeros()
    rows = rows.T.tocsr() if of_columns else rows
    rows.sort_indices()
    return tuple(np.split(rows.indices.astype(np.int64), rows.indptr[1:-1]))


def read_matrix_file(
    file: Path, key: str, shape: tuple[int, int], axes: tuple[str, str], advice: str, of_columns: bool = False
) -> Positives:
    """Return `read_matrix` of a matrix in an .npz file.

    Raises MissingData, with `advice`, without a file, BadInput for any other matrix.
    """
    wanted = f"a matrix {key} of yes and no, {shape[0]} {axes[0]} by {shape[1]} {axes[1]}"
    arrays = load_arrays(file, {key: shape[0] * shape[1]}, wanted, advice)
    return read_matrix(f"{key} in {file}", arrays[key], shape, axes, of_columns)


def load_arrays(file: Path, most_values: Mapping[str, int], wanted: str, advice: str) -> dict[str, npt.NDArray[Any]]:
    """Return those of the named arrays that an .npz file holds; it may hold plain numbers alone.

    `most_values` bounds the size of each, and `wanted` says what the file has to hold. Raises MissingData, with
    `advice`, without a file, BadInput for one that cannot be read, holds none of them, or holds more.
    """
    if not file.is_file():
        raise MissingData(f"{file} is no file: {advice}")
    try:
        with zipfile.ZipFile(file) as members:
            sizes = {member.filename.removesuffix(".npy"): member.file_size for member in members.infolist()}
        large = [key for key, most in most_values.items() if sizes.get(key, 0) > 8 * most + (1 << 16)]
        with np.load(file, allow_pickle=False) as stored:
            arrays = {} if large else {key: stored[key] for key in most_values if key in sizes}
    except _ERRORS as error:
        reason = (str(error).splitlines() or [""])[0]
        raise BadInput(f"{file} cannot be read ({reason}): get it from its source again") from error
    if large:
        excess = f"{large[0]} in {file} unpacks to {sizes[large[0]]} bytes"
        raise BadInput(f"{excess}, and wanted is {wanted}: check that no image is missing")
    if not arrays:
        held = ", ".join([*sizes][:_SHOWN]) or "nothing"
        raise BadInput(f"{file} holds no {next(iter(most_values))}, but {held}: wanted is {wanted}; {advice}")
    return arrays


def _is_matrix(table: npt.NDArray[Any], n_queries: int, n_places: int) -> bool:
    """Tell whether a table is a matrix of 0 and 1 over all places; raises BadInput where it may also list places.

    Integers are a matrix where, as lists of places, they name a place twice or one that does not exist.
    """
    if table.ndim != 2 or not table.size or table.dtype.kind not in "buif" or not np.isin(table, (0, 1)).all():
        return False
    names_one_twice = table.shape[1] > 2 or bool((table[:, 1:] == table[:, :-1]).any())
    if table.dtype.kind in "bf" or names_one_twice or table.max() >= n_places:
        return True
    if table.shape != (n_queries, n_places):
        return False
    raise BadInput(
        f"positives={table.tolist()[:2]} and so on may be a matrix of 0 and 1, or lists of places: give "
        f"np.array(positives, bool) for the matrix, np.ones({table.shape}, bool) for the lists"
    )
