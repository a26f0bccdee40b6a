"""Folders of VPR-Bench: query/, ref/ and a ground truth by number, as a pickle that is never run or as a CSV."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal, Unpack

from vprbench.api import BadInput, Dataset, MissingData, NumberReading, order_by_numbers

from .readers.csv_tables import read_csv
from .readers.file_dataset import FileOptions, dataset_of_files, make_ground_truth, unknown
from .readers.frame_folders import find_folder, find_root
from .readers.image_files import images_in
from .readers.pickled_lists import read_lists

OutOfRange = Literal["error", "clip"]
Rows = list[tuple[int, list[int]]]  # a query and its right references

GROUND_TRUTHS = ("ground_truth_new.npy", "ground_truth.csv")

_LAYOUT = (
    "python -m vprbench fetch corridor gets Corridor, the other sets are linked in the README of "
    "github.com/MubarizZaffar/VPR-Bench; set dataset.root to a folder with query/, ref/ and "
    + " or ".join(GROUND_TRUTHS)
)


def vpr_bench(
    name: str = "vpr_bench",
    root: str | None = None,
    ground_truth: str | None = None,
    out_of_range: OutOfRange = "error",
    default_root: str | None = None,
    numbers: NumberReading = "whole",
    **options: Unpack[FileOptions],
) -> Dataset:
    """Return the images of `<root>/query` and `<root>/ref`, in natural order (2.jpg before 10.jpg), numbered from 0.

    `numbers` in names are whole ones (0.5 before 0.25), or decimal; under auto the names tell.

    Every reference is a place. `ground_truth` is a file in `root`, the first of `GROUND_TRUTHS` that is there if None:
    rows of a query and its right references, by number (an array of objects, pickled), or a CSV with the columns query
    and matching_refs, numbers with spaces between them. Numbers without an image are an error, or are left out with
    `clip`; how many queries that concerns is noted. With `ground_truth` none no file is read, and no answer is judged.
    `default_root` (relative to the checkout) stands in for a `root` of None if it exists. Raises MissingData for what
    is missing, BadInput for a ground truth that does not fit.
    """
    top = find_root(name, root, "query/ and ref/", _LAYOUT, default_root=default_root, parts=("query", "ref"))
    folders = (find_folder(top, part) for part in ("query", "ref"))
    found = [images_in(folder, "dataset.root", _LAYOUT, deep=False) for folder in folders]
    (query_files, map_files), read, notes = order_by_numbers(found, numbers)
    protocol: dict[str, Any] = {"protocol": "vpr_bench", "references": "ref", "queries": "query", **read}
    truth = unknown(len(map_files), len(query_files))
    if ground_truth != "none":
        stored = _find_ground_truth(top, ground_truth)
        rows = _read_csv_rows(stored) if stored.suffix.lower() == ".csv" else _read_pickled_rows(stored)
        by_query, corrected = check_rows(stored.name, rows, len(query_files), len(map_files), out_of_range)
        truth = make_ground_truth(len(map_files), by_query, f"no right reference in {stored.name}")
        protocol |= {"ground_truth": stored.name, "out_of_range": out_of_range, "out_of_range_queries": len(corrected)}
        if corrected:
            count = f"{stored.name} names numbers without an image in {len(corrected)} of {len(rows)} rows"
            notes.append(f"{count} (first: query {corrected[0]}); they are left out (dataset.out_of_range=clip)")
    return dataset_of_files(name, map_files, query_files, truth, protocol, notes, **options)


def check_rows(
    owner: str, rows: Rows, n_queries: int, n_references: int, out_of_range: OutOfRange
) -> tuple[list[list[int]], list[int]]:
    """Return the right references of every query, ascending, and the queries whose rows held numbers without an image.

    Such numbers are left out with `clip`, else BadInput names the first row with one. Raises BadInput as well for a
    query with two rows or none. `owner` is the file that messages name.
    """
    by_query: dict[int, list[int]] = {}
    corrected = []
    for query, right in rows:
        if query in by_query:
            raise BadInput(f"{owner} has two rows for query {query}: leave one")
        by_query[query] = sorted({reference for reference in right if 0 <= reference < n_references})
        wrong = [reference for reference in right if not 0 <= reference < n_references]
        if 0 <= query < n_queries and not wrong:
            continue
        corrected.append(query)
        if out_of_range == "error":
            raise BadInput(
                f"{owner} names reference {', '.join(map(str, (wrong or right)[:5]))} for query {query}, but query/ "
                f"holds {n_queries} and ref/ {n_references} images, numbered from 0: check that no image is missing, "
                "or pass dataset.out_of_range=clip to leave such numbers out"
            )
    if without := [query for query in range(n_queries) if query not in by_query]:
        raise BadInput(
            f"{owner} has no row for {len(without)} of {n_queries} queries (first: query {without[0]}): give each one, "
            "with an empty list where no reference is right"
        )
    return [by_query[query] for query in range(n_queries)], corrected


def _find_ground_truth(top: Path, name: str | None) -> Path:
    wanted = [name] if name else GROUND_TRUTHS
    found = next((top / file for file in wanted if (top / file).is_file()), None)
    if found is None:
        raise MissingData(f"{top} holds no {' and no '.join(wanted)}: {_LAYOUT}")
    return found


def _read_pickled_rows(path: Path) -> Rows:
    """Return query and right references of each row of a ground_truth_new.npy."""
    advice = "get the file from its source again, or write ground_truth.csv with the columns query,matching_refs"
    rows = []
    for number, row in enumerate(read_lists(path, advice)):
        pair = isinstance(row, list) and len(row) == 2 and isinstance(row[1], list)
        numbers: list[Any] = [row[0], *row[1]] if pair else [None]
        if not all(type(n) in (int, float) and n == n // 1 for n in numbers):
            raise BadInput(f"row {number} of {path} is no [query, [references]] of whole numbers: {advice}")
        rows.append((int(numbers[0]), [int(reference) for reference in numbers[1:]]))
    return rows


def _read_csv_rows(path: Path) -> Rows:
    """Return query and right references of each row of a ground_truth.csv."""
    wanted = "query and matching_refs"
    table = read_csv(path, wanted)
    if not {"query", "matching_refs"} <= {*table.columns}:
        raise BadInput(f"{path} has the columns {', '.join(table.columns)}; wanted are {wanted}")
    rows = []
    for number, (query, right) in enumerate(zip(table["query"], table["matching_refs"], strict=True), 1):
        try:
            rows.append((int(query), [int(reference) for reference in right.split()]))
        except ValueError as error:
            raise BadInput(
                f"row {number} of {path} is no query and its references: wanted are whole numbers, as in 5,3 4 5"
            ) from error
    return rows
