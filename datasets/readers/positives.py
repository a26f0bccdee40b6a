"""The right places of each query, read from lists of places or from a matrix."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array, issparse

from vprbench.api import BadInput

Positives = tuple[npt.NDArray[np.int64], ...]

_AXES = ("queries", "places")


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
    if issparse(positives):
        return read_matrix("positives", positives, (n_queries, n_places), _AXES)
    try:
        table = np.asarray(positives)
    except ValueError:  # lists of unequal length
        table = np.empty(0, object)
    if _is_matrix(table, n_queries, n_places):
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
    is_numeric = matrix.dtype.kind in "buif"
    rows = csr_array(matrix, copy=True) if is_numeric else csr_array(shape)
    rows.sum_duplicates()
    if not is_numeric or not np.isin(rows.data, (0, 1)).all():
        raise BadInput(f"{named} holds {matrix.dtype} values other than 0 and 1: yes and no are wanted")
    rows.eliminate_zeros()
    rows = rows.T.tocsr() if of_columns else rows
    rows.sort_indices()
    return tuple(np.split(rows.indices.astype(np.int64), rows.indptr[1:-1]))


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
