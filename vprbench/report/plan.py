"""The parts of Table II and of the figures: rows, columns and sizes of the growth."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, get_args

import yaml

from vprbench.errors import BadInput

Boundary = Literal["encode", "match"]  # the step that the paper's query rate of a row covers
Training = Literal["own", "none", "pretrained", "map"]  # map: it builds the map and trains nothing


@dataclass(frozen=True)
class Row:
    """A row of the table: a method with the arguments that set it apart, and the step that the paper timed."""

    name: str
    method: str
    boundary: Boundary | None = None  # None: not one of the paper's rows
    training: Training = "own"
    spiking: bool = False  # stands below the rule that ends the conventional methods
    arguments: Mapping[str, Any] = field(default_factory=dict)
    seeds: tuple[int, ...] = (0,)
    rate_remark: str | None = None  # fixed words on how the paper timed its queries
    most_places: int | None = None  # with more it takes too long for a table; None: any number
    seeds_unless_full: int | None = None  # the first so many of `seeds` unless slow rows are to run in full; None: all

    @property
    def learns_here(self) -> bool:
        """Tell whether there is a time in which it learns the map, by training or without."""
        return self.training in ("own", "map")


@dataclass(frozen=True)
class PlannedColumn:
    """A group of columns: a dataset with its options, and the published dataset that it stands beside."""

    name: str
    title: str
    options: tuple[str, ...]  # of the command line
    published: str | None = None  # the dataset of the paper's table
    stand_in_for: str | None = None  # the column of real frames that a rendered one stands in for
    on_request: bool = False  # shown only where columns= names it
    frames: str | None = None  # the option of a table that gives the root of its dataset
    remark: str | None = None  # fixed words on the data


@dataclass(frozen=True)
class Growth:
    """The runs behind time against the number of places."""

    rows: tuple[str, ...]
    options: tuple[str, ...]  # of the dataset
    sizes: tuple[int, ...]  # places
    queries: int  # at most

    def column(self, places: int) -> PlannedColumn:
        """Return the column of one size; of the synthetic route the first 2/11 of the places are not queried."""
        queries = min(self.queries, places - round(places * 2 / 11))
        options = (*self.options, f"dataset.places={places}", f"dataset.query_places={queries}")
        return PlannedColumn(f"growth_{places}", f"{places:,} places", options)


@dataclass(frozen=True)
class Plan:
    """Everything in conf/table.yaml, by name."""

    rows: Mapping[str, Row]  # of the paper's table
    more_rows: Mapping[str, Row]  # on request
    columns: Mapping[str, PlannedColumn]
    growth: Growth
    seeds: tuple[int, ...] = (0,)  # of rows that methods= names by their method and that learn from a seed


#: The plan of runs that no table names.
NO_PLAN = Plan({}, {}, {}, Growth((), (), (), 0))


def read_plan(path: Path) -> Plan:
    """Read the plan; raises BadInput, naming the file, where a part is missing or unknown."""
    with _explaining_plan_errors(path):
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        rows, more = (
            {name: _row(name, given) for name, given in content[group].items()} for group in ("rows", "more_rows")
        )
        columns = {name: _column(name, given) for name, given in content["columns"].items()}
        growth = _growth(**content["growth"])
        first, *more_seeds = content["seeds"]
    _require_columns(columns, path)
    return Plan(rows, more, columns, growth, (first, *more_seeds))


def add_plug_ins(plan: Plan, folders: Mapping[str, Path]) -> Plan:
    """Return our plan with the rows and columns that plug-ins bring; `folders` are those of yaml files, by provider.

    A plug-in's `table/*.yaml` may hold `rows` and `columns` as ours does; both are shown where they are asked for by
    name. Raises BadInput that names both owners if a name is taken.
    """
    rows, columns = dict(plan.more_rows), dict(plan.columns)
    ours = [*plan.rows, *rows, *columns, *(row.name for row in rows.values())]
    owners = dict.fromkeys(ours, "vprbench")
    for provider, path in _list_plug_in_files(folders):
        more_rows, more_columns = _read_plug_in(path)
        for name in dict.fromkeys([*more_rows, *more_columns, *(row.name for row in more_rows.values())]):
            if name in owners:
                raise BadInput(f"{path}: {name} of {provider} has the name of one of {owners[name]}: rename it")
            owners[name] = provider
        rows |= more_rows
        columns |= {name: replace(column, on_request=True) for name, column in more_columns.items()}
        _require_columns(columns, path)
    return replace(plan, more_rows=rows, columns=columns)


def _list_plug_in_files(folders: Mapping[str, Path]) -> list[tuple[str, Path]]:
    return [
        (provider, path)
        for provider, folder in folders.items()
        if provider != "vprbench"
        for path in sorted((folder / "table").glob("*.yaml"))
    ]


def _read_plug_in(path: Path) -> tuple[dict[str, Row], dict[str, PlannedColumn]]:
    """Read the rows and columns of a plug-in's file."""
    with _explaining_plan_errors(path):
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        if unknown := content.keys() - {"rows", "columns"}:
            raise KeyError(*unknown)
        rows = {name: _row(name, given) for name, given in content.get("rows", {}).items()}
        return rows, {name: _column(name, given) for name, given in content.get("columns", {}).items()}


@contextmanager
def _explaining_plan_errors(path: Path) -> Iterator[None]:
    try:
        yield
    except (OSError, yaml.YAMLError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise BadInput(f"{path} is no plan of a table ({error}): compare it with the one of this project") from error


def _require_columns(columns: Mapping[str, PlannedColumn], origin: object) -> None:
    for column in columns.values():
        if column.stand_in_for is not None and column.stand_in_for not in columns:
            named = column.stand_in_for
            raise BadInput(f"{origin}: column {column.name} names {named}, which is none: there are {[*columns]}")


def _row(name: str, given: Mapping[str, Any]) -> Row:
    row = Row(**{"name": name, **given, "seeds": tuple(given.get("seeds", (0,)))})
    if row.boundary not in (None, *get_args(Boundary)) or row.training not in get_args(Training) or not row.seeds:
        raise TypeError(f"row {name}: boundary {row.boundary}, training {row.training}, seeds {list(row.seeds)}")
    return row


def _growth(rows: list[str], options: list[str], sizes: list[int], **rest: Any) -> Growth:
    return Growth(tuple(rows), tuple(options), tuple(sizes), **rest)


def _column(name: str, given: Mapping[str, Any]) -> PlannedColumn:
    return PlannedColumn(name, **{**given, "options": tuple(given["options"])})
