"""The plan of the table names what there is, and the published numbers are those of the paper."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from vprbench.interface import BadInput
from vprbench.plan import QUANTITIES, Plan, PlannedColumn, Row, published, read_plan

PLAN = Path(__file__).resolve().parents[1] / "conf" / "table.yaml"


@pytest.fixture(scope="module")
def plan() -> Plan:
    return read_plan(PLAN)


@pytest.fixture
def content() -> Any:
    return yaml.safe_load(PLAN.read_text(encoding="utf-8"))


def written(content: Any, folder: Path) -> Path:
    path = folder / "table.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def test_the_rows_are_those_of_the_paper_in_its_order(plan: Plan) -> None:
    assert list(plan.rows) == ["SAD", "NetVLAD", "GCL", "VPRSNN", "VPRTempo"]
    assert [row.spiking for row in plan.rows.values()] == [False, False, False, True, True]
    assert [row.training for row in plan.rows.values()] == ["none", "pretrained", "pretrained", "own", "own"]


def test_rates_cover_what_the_paper_timed(plan: Plan) -> None:
    # feature extraction for the networks, matching for the others
    assert {name for name, row in plan.rows.items() if row.boundary == "encode"} == {"NetVLAD", "GCL"}


def test_every_row_and_dataset_of_the_paper_has_five_published_numbers(plan: Plan) -> None:
    printed = published()
    assert {row for row, _ in printed} == set(plan.rows)
    assert all(tuple(cells) == QUANTITIES for cells in printed.values())
    assert sum(value is None for cells in printed.values() for value in cells.values()) == 8


@pytest.mark.parametrize(
    ("row", "dataset", "numbers"),
    [
        ("VPRTempo", "Nordland", [56, 60, 353, 1, 1634]),
        ("VPRTempo", "Oxford RobotCar", [37, 3, 1670, 0.3, 1955]),
        ("SAD", "Oxford RobotCar", [37, None, 185, None, 126]),
        ("VPRSNN", "Nordland", [53, 360, 2, None, None]),
        ("GCL", "Oxford RobotCar", [33, 360, 0.4, 360, 75]),
    ],
)
def test_published_numbers_are_those_of_table_two(row: str, dataset: str, numbers: list[float | None]) -> None:
    assert list(published()[row, dataset].values()) == numbers


def test_columns_of_the_paper_name_a_dataset_that_it_has(plan: Plan) -> None:
    datasets = {dataset for _, dataset in published()}
    assert {column.published for column in plan.columns.values()} - {None} == datasets


def test_a_stand_in_stands_for_a_column_that_stands_for_none(plan: Plan) -> None:
    for column in plan.columns.values():
        if column.stand_in_for is not None:
            assert plan.columns[column.stand_in_for].stand_in_for is None


def test_the_arguments_of_a_row_come_before_those_that_the_size_needs() -> None:
    column = PlannedColumn("x", "X", (), fits={"little": {"module": 5, "window": 1}})
    assert column.arguments(Row("A", "little", arguments={"window": 9})) == {"module": 5, "window": 9}
    assert column.arguments(Row("B", "other")) == {}


def test_a_row_on_request_has_a_name_of_its_own(plan: Plan) -> None:
    assert plan.more_rows["vprtempo_public"].name == "VPRTempo (public code)"
    names = [row.name for row in (*plan.rows.values(), *plan.more_rows.values())]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("group", ["rows", "columns", "growth"])
def test_a_plan_without_a_part_is_refused_by_its_file(group: str, content: Any, tmp_path: Path) -> None:
    del content[group]
    with pytest.raises(BadInput, match=rf"table\.yaml is no plan of a table.*{group}"):
        read_plan(written(content, tmp_path))


def test_an_unknown_part_of_a_row_is_refused(content: Any, tmp_path: Path) -> None:
    content["rows"]["SAD"]["colour"] = "red"
    with pytest.raises(BadInput, match="colour"):
        read_plan(written(content, tmp_path))


@pytest.mark.parametrize("reference", ["smaller", "stand_in_for"])
def test_a_column_that_names_one_that_is_none_is_refused(reference: str, content: Any, tmp_path: Path) -> None:
    content["columns"]["railway"][reference] = "moon"
    with pytest.raises(BadInput, match="column railway names moon, which is none"):
        read_plan(written(content, tmp_path))


def test_a_missing_plan_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"nowhere\.yaml is no plan"):
        read_plan(tmp_path / "nowhere.yaml")


def test_the_sizes_of_the_growth_ask_for_no_more_queries_than_there_are_places(plan: Plan) -> None:
    for size in plan.growth.sizes:
        column = plan.growth.column(size)
        asked = {name: int(value) for name, _, value in (text.partition("=") for text in column.options[-2:])}
        assert asked["dataset.places"] == size
        assert 0 < asked["dataset.query_places"] <= size * 9 / 11 + 1


@pytest.mark.parametrize(
    ("part", "value"), [("boundary", "everything"), ("training", "somehow"), ("seeds", [])], ids=lambda v: str(v)
)
def test_a_row_that_means_nothing_is_refused_by_name(content: Any, tmp_path: Path, part: str, value: object) -> None:
    content["rows"]["SAD"][part] = value
    with pytest.raises(BadInput, match="row SAD"):
        read_plan(written(content, tmp_path))


def test_fewer_places_lower_an_argument_of_the_growth(plan: Plan) -> None:
    vprtempo = plan.rows["VPRTempo"]
    assert [plan.growth.column(n).arguments(vprtempo) for n in (100, 3000)] == [{"max_module": 100}, {}]


def test_the_growth_asks_for_few_queries_and_never_for_more_than_there_are(plan: Plan) -> None:
    options = [plan.growth.column(n).options[-1] for n in (100, 27_000)]
    assert options == ["dataset.query_places=82", "dataset.query_places=300"]
