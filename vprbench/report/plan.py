"""The plan of a table and of its figures: rows, columns, sizes of the growth, and the published table beside it."""

from __future__ import annotations

import csv
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import yaml
from pydantic import Field

from vprbench.errors import BadInput
from vprbench.plugins.options import check_value

Boundary = Literal["encode", "match"]  # the step that the published query rate of a row covers
Training = Literal["own", "none", "pretrained", "map"]  # map: it builds the map and trains nothing
Seeds = Annotated[tuple[int, ...], Field(min_length=1)]
Numbers = Mapping[tuple[str, str], Mapping[str, float | None]]
_FORBID = {"extra": "forbid"}

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
class PlannedColumn:
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


@dataclass(frozen=True)
class Growth:
    """The runs behind time against the number of places."""

    __pydantic_config__: ClassVar[Any] = _FORBID

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


_BY_NAME: dict[str, type] = {"rows": Row, "more_rows": Row, "columns": PlannedColumn}
_WHOLE: dict[str, Any] = {"growth": Growth, "seeds": Seeds, "published": Published}


@dataclass(frozen=True)
class PlanFile:
    """Everything in conf/paper/table2.yaml, by name."""

    rows: Mapping[str, Row]  # shown unless a request names others
    more_rows: Mapping[str, Row]  # on request
    columns: Mapping[str, PlannedColumn]
    growth: Growth
    seeds: tuple[int, ...] = (0,)  # of rows that methods= names by their method and that learn from a seed
    published: Published | None = None


#: The plan of runs that no table names.
NO_PLAN = PlanFile({}, {}, {}, Growth((), (), (), 0))


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
    plan = PlanFile(**_read_parts(path, {*_BY_NAME, *_WHOLE}))
    if plan.published is None:
        return plan
    numbers = _read_published_numbers(path.parent / plan.published.numbers_file)
    return replace(plan, published=replace(plan.published, numbers=numbers))


def add_plug_ins(plan: PlanFile, folders: Mapping[str, Path]) -> PlanFile:
    """Return our plan with the rows and columns that plug-ins bring; `folders` are those of yaml files, by provider.

    A plug-in's `table/*.yaml` may hold `rows` and `columns` as ours does; a request names what it shows of them. Raises
    BadInput if a name is taken.
    """
    rows, columns = dict(plan.more_rows), dict(plan.columns)
    for provider, folder in folders.items():
        for path in sorted((folder / "table").glob("*.yaml")) if provider != "vprbench" else ():
            more = _read_parts(path, {"rows", "columns"}, columns)
            if taken := _list_names(more["rows"], more["columns"]) & _list_names({**plan.rows, **rows}, columns):
                raise BadInput(
                    f"{path}: {', '.join(sorted(taken))} of {provider} is the name of another one: rename it"
                )
            rows |= more["rows"]
            columns |= {name: replace(column, on_request=True) for name, column in more["columns"].items()}
    return replace(plan, more_rows=rows, columns=columns)


def _list_names(rows: Mapping[str, Row], columns: Collection[str]) -> set[str]:
    return {*rows, *(row.name for row in rows.values()), *columns}


def _read_parts(path: Path, names: Collection[str], known: Collection[str] = ()) -> dict[str, Any]:
    """Return the parts of a yaml, rows and columns by name; `known` columns may be stood in for too."""
    try:
        content: dict[str, Any] = {"rows": {}, "columns": {}, **yaml.safe_load(path.read_text(encoding="utf-8"))}
        if wrong := (content.keys() ^ names) - ({"published"} & {*names}):
            raise ValueError(f"{', '.join(wrong)} is missing or unknown")
        named = {
            group: {name: {"name": name, **given} for name, given in content[group].items()}
            for group in content.keys() & _BY_NAME.keys()
        }
    except (OSError, yaml.YAMLError, TypeError, ValueError, AttributeError) as error:
        raise BadInput(f"{path} is no plan of a table ({error}): compare it with the one of this project") from error
    parts = {
        group: check_value(f"{path}: {group}", content[group], kind)
        for group, kind in _WHOLE.items()
        if group in content
    }
    for group, given in named.items():
        parts[group] = {
            name: check_value(f"{path}: {group}.{name}", each, _BY_NAME[group]) for name, each in given.items()
        }
    columns = [*known, *parts["columns"]]
    for column in parts["columns"].values():
        if column.stand_in_for not in (None, *columns):
            stood_in = f"names {column.stand_in_for}, which is none: there are {columns}"
            raise BadInput(f"{path}: column {column.name} {stood_in}")
    return parts


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
