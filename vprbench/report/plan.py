"""The plan of a table and of its figures: rows, columns, sizes of the growth, and the published table beside it."""

from __future__ import annotations

import csv
import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeVar

import yaml
from pydantic import Field, TypeAdapter, ValidationError

from vprbench.errors import BadInput
from vprbench.runs.sequences import Views
from vprbench.text import shorten

Boundary = Literal["encode", "match"]  # the step that the published query rate of a row covers
Training = Literal["own", "none", "pretrained", "map"]  # map: it builds the map and trains nothing
Seeds = Annotated[tuple[int, ...], Field(min_length=1)]
Numbers = Mapping[tuple[str, str], Mapping[str, float | None]]
_FORBID = {"extra": "forbid"}
Content = TypeVar("Content", bound="MoreRows")

PLAN_FILE = "paper/table2.yaml"  # in conf/: the plan of `vprbench table`


@dataclass(frozen=True)
class Row:
    """A row of the table: a method with the arguments that set it apart, and the step whose rate is published."""

    __pydantic_config__: ClassVar[Any] = _FORBID

    name: str
    method: str
    boundary: Boundary | None = None  # None: not published
    training: Training = "own"
    spiking: bool = False  # stands below the rule that ends the conventional methods
    arguments: Mapping[str, Any] = field(default_factory=dict)
    seeds: Seeds = (0,)
    rate_remark: str | None = None  # fixed words on how the published rate was timed
    most_places: int | None = None  # with more it takes too long for a table; None: any number
    seeds_unless_full: int | None = None  # the first so many of `seeds` unless slow rows are to run in full; None: all

    @property
    def learns_here(self) -> bool:
        """Tell whether there is a time in which it learns the map, by training or without."""
        return self.training in ("own", "map")


@dataclass(frozen=True)
class Column:
    """A group of columns: a dataset with its options, and the published dataset that it stands beside."""

    __pydantic_config__: ClassVar[Any] = _FORBID

    name: str
    title: str
    options: tuple[str, ...]  # of the command line
    published: str | None = None  # its name in the published table
    stand_in_for: str | None = None  # the column of real frames that a rendered one stands in for
    on_request: bool = False  # shown only where columns= names it
    frames: str | None = None  # the option of a table that gives the root of its dataset
    remark: str | None = None  # fixed words on the data
    # Of a request:
    dataset: Mapping[str, Any] = field(default_factory=dict)  # its resolved arguments
    corruption: str | list[str] | None = None  # of the query frames; None: they are clean
    views: Any = None  # the option that says from which viewpoints queries are asked
    condition: str | None = None  # of its runs alone (`selection.describe_condition`); None: runs of these arguments


@dataclass(frozen=True)
class Growth:
    """The runs behind time against the number of places."""

    __pydantic_config__: ClassVar[Any] = _FORBID

    rows: tuple[str, ...]
    options: tuple[str, ...]  # of the dataset
    sizes: tuple[int, ...]  # places
    queries: int  # at most

    def column(self, places: int) -> Column:
        """Return the column of one size; of the synthetic route the first 2/11 of the places are not queried."""
        queries = min(self.queries, places - round(places * 2 / 11))
        options = (*self.options, f"dataset.places={places}", f"dataset.query_places={queries}")
        return Column(f"growth_{places}", f"{places:,} places", options)


@dataclass(frozen=True)
class Published:
    """A published table: its numbers, and the facts by which a reader compares them with measured ones."""

    __pydantic_config__: ClassVar[Any] = _FORBID

    title: str  # of the table that stands beside it
    source: str  # the publication and its table
    cpu: str  # of its machine
    gpu: str
    numbers_file: str  # beside the plan: a CSV with method, dataset, metric and value
    protocols: Mapping[str, str] = field(default_factory=dict)  # by dataset: places, queries and tolerance in words
    figures: Mapping[str, str] = field(default_factory=dict)  # numbers of its figures by their names here
    shown_row: str | None = None  # the row whose similarities it draws
    growth_claim: str = ""  # on time against places, a sentence
    numbers: Numbers = field(default_factory=dict)  # by row and dataset: numbers by metric, None where it has a dash

    def number_figure(self, name: str) -> str:
        """Return the name of a figure after its number in the publication; the name alone if it has none."""
        kinds = (kind for kind in self.figures if name == kind or name.startswith(f"{kind}-"))
        return next((f"{self.figures[kind]}-{name}" for kind in kinds), name)


@dataclass(frozen=True)
class MoreRows:
    """The rows and columns that a plug-in brings, by name."""

    __pydantic_config__: ClassVar[Any] = _FORBID

    rows: Mapping[str, Row] = field(default_factory=dict)  # of a plug-in: on request
    columns: Mapping[str, Column] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class PlanFile(MoreRows):
    """Everything in conf/paper/table2.yaml, by name."""

    more_rows: Mapping[str, Row]  # on request
    growth: Growth
    seeds: Seeds  # of rows that methods= names by their method and that learn from a seed
    published: Published | None = None


@dataclass(frozen=True, kw_only=True)
class Plan:
    """The rows and columns of a request, resolved."""

    rows: tuple[Row, ...]
    columns: tuple[Column, ...]
    devices: tuple[str, ...] = ("cpu",)
    full: bool = True
    metrics: tuple[str, ...] = ()
    results: str = "results"
    stores: tuple[str, ...] = ()  # results folders of other machines
    stored: bool = False  # nothing is run
    views: tuple[Views, ...] = ()  # views of the stored runs that are shown; none: the runs themselves
    title: str | None = None  # None: of the published table, whose rows stay in their order
    published: Published | None = None  # the table that it stands beside
    growth_rows: tuple[Row, ...] = ()  # whose time against places is drawn, with one seed each
    growth_columns: tuple[Column, ...] = ()  # one of each size

    @property
    def heading(self) -> str:
        """The title above its table."""
        return self.title or (self.published.title if self.published else "Runs")

    def is_slow(self, column: Column, row: Row) -> bool:
        """Tell whether a row takes too long in a column for the time that a table has."""
        places = column.dataset.get("places")
        too_many = row.most_places is not None and isinstance(places, int) and places > row.most_places
        return too_many and not self.full


def flatten_arguments(arguments: Mapping[str, Any], above: str = "") -> dict[str, Any]:
    """Return arguments by their names after `above`; a value inside a mapping has a dotted name."""
    found: dict[str, Any] = {}
    for name, value in arguments.items():
        found |= (
            flatten_arguments(value, f"{above}{name}.")
            if isinstance(value, Mapping) and value
            else {f"{above}{name}": value}
        )
    return found


def read_plan(path: Path) -> PlanFile:
    """Read the plan; raises BadInput, naming the file, where a part is missing or unknown."""
    plan = _read_file(path, PlanFile)
    if plan.published is None:
        return plan
    numbers = _read_published_numbers(path.parent / plan.published.numbers_file)
    return replace(plan, published=replace(plan.published, numbers=numbers))


def add_plug_ins(plan: PlanFile, folders: Mapping[str, Path]) -> PlanFile:
    """Return our plan with the rows and columns that plug-ins bring; `folders` are those of yaml files, by provider.

    A plug-in's `table/*.yaml` may hold `rows` and `columns` as ours does; a request names what it shows of them. Raises
    BadInput if a name is taken.
    """
    for provider, folder in folders.items():
        for path in sorted((folder / "table").glob("*.yaml")) if provider != "vprbench" else ():
            more = _read_file(path, MoreRows, plan.columns)
            known = {**plan.rows, **plan.more_rows}
            if taken := _list_names(more.rows, more.columns) & _list_names(known, plan.columns):
                raise BadInput(
                    f"{path}: {', '.join(sorted(taken))} of {provider} is the name of another one: rename it"
                )
            columns = {name: replace(column, on_request=True) for name, column in more.columns.items()}
            plan = replace(plan, more_rows={**plan.more_rows, **more.rows}, columns={**plan.columns, **columns})
    return plan


def _list_names(rows: Mapping[str, Row], columns: Collection[str]) -> set[str]:
    return {*rows, *(row.name for row in rows.values()), *columns}


def _read_file(path: Path, kind: type[Content], known: Collection[str] = ()) -> Content:
    """Return the content of a yaml, whose rows and columns have the names of their keys; raises BadInput.

    A column may stand in for `known` ones too.
    """
    try:
        content: dict[str, Any] = yaml.safe_load(path.read_text(encoding="utf-8"))
        for group in content.keys() & {"rows", "more_rows", "columns"}:
            content[group] = {name: {"name": name, **given} for name, given in content[group].items()}
        found = TypeAdapter(kind).validate_json(json.dumps(content), strict=True)  # a list there may be a tuple here
    except ValidationError as error:
        wrong = (shorten(f"{'.'.join(map(str, one['loc']))}={one['input']}: {one['msg']}") for one in error.errors())
        raise BadInput(f"{path}: {'; '.join(wrong)}") from error
    except (OSError, yaml.YAMLError, TypeError, AttributeError) as error:
        raise BadInput(f"{path} is no plan of a table ({error}): compare it with the one of this project") from error
    for name, column in found.columns.items():
        if column.stand_in_for not in (None, *known, *found.columns):
            raise BadInput(f"{path}: column {name} stands in for {column.stand_in_for}, which is no column")
    return found


def _read_published_numbers(path: Path) -> Numbers:
    """Return the numbers of a CSV by row and dataset: R@1 in %, training in minutes, queries in Hz; None is a dash."""
    printed: dict[tuple[str, str], dict[str, float | None]] = {}
    try:
        with path.open(encoding="utf-8", newline="") as file:
            for line in csv.DictReader(file):
                cells = printed.setdefault((line["method"], line["dataset"]), {})
                cells[line["metric"]] = float(line["value"]) if line["value"] else None
    except (OSError, KeyError, ValueError) as error:
        reason = f"holds no published numbers ({error})"
        raise BadInput(f"{path} {reason}: compare it with the one of this project") from error
    return printed
