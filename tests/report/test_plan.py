"""The plan of the table names what there is, and the published numbers are those of the paper."""

import pytest
import yaml
from checkout import ROOT
from omegaconf import OmegaConf
from stored_runs import NAMES, PAPER

from vprbench.config import make_request
from vprbench.errors import BadInput
from vprbench.plugins import registry
from vprbench.report.gather import list_cells, resolve_plan
from vprbench.report.plan import PLAN_FILE, add_plug_ins, read_plan
from vprbench.report.run_options import TableRequest

PLAN = ROOT / "conf" / PLAN_FILE


def chosen(**asked):
    return resolve_plan(TableRequest(**{"devices": ["cpu"], **asked}))


def of_last_row(here):
    return [*list_cells(here, here.columns[0], here.rows[-1:], [])]


def test_rows_and_published_numbers_are_those_of_table_two_in_its_order():
    rows = {row.name: (row.spiking, row.training, row.boundary) for row in PAPER.rows.values()}
    assert list(rows.items()) == [
        ("SAD", (False, "none", "match")),
        ("NetVLAD", (False, "pretrained", "encode")),
        ("GCL", (False, "pretrained", "encode")),
        ("VPRSNN", (True, "own", "match")),
        ("VPRTempo", (True, "own", "match")),
    ]
    printed = PAPER.published.numbers
    assert {row for row, _ in printed} == set(PAPER.rows)
    assert all(tuple(cells) == NAMES for cells in printed.values())
    assert sum(value is None for cells in printed.values() for value in cells.values()) == 8
    for row, dataset, *numbers in (
        ("VPRTempo", "Nordland", 56, 60, 353, 1, 1634),
        ("VPRTempo", "Oxford RobotCar", 37, 3, 1670, 0.3, 1955),
        ("SAD", "Oxford RobotCar", 37, None, 185, None, 126),
        ("VPRSNN", "Nordland", 53, 360, 2, None, None),
        ("GCL", "Oxford RobotCar", 33, 360, 0.4, 360, 75),
    ):
        assert list(printed[row, dataset].values()) == numbers


def test_every_row_that_learns_from_a_seed_has_three_and_says_whether_its_scores_are_calibrated():
    methods, calibrated = registry.find_entries("method"), []
    rows = [*PAPER.rows.values(), *PAPER.more_rows.values()]
    assert len({row.name for row in rows}) == len(rows)
    for row in rows:
        options = methods[row.method].options
        assert len({*row.seeds}) == (3 if "seed" in options else 1), row.name
        assert {*row.arguments} <= {*options}, row.name
        if "calibrated_scores" in options:
            asked = {f"method.{name}": value for name, value in row.arguments.items()}
            arguments = make_request([f"method={row.method}"], asked).method
            assert ("calibrated" in row.name) == (arguments["calibrated_scores"] is True)
            calibrated += [row.method] * (arguments["calibrated_scores"] is True)
    assert sorted(calibrated) == ["vprtempo", "vprtempo_ensemble", "vprtempo_tuned_ensemble"]
    for kind in ("", "tuned_", "oriented_"):  # members of seed s, in no two runs: s to s + 4
        seeds = PAPER.more_rows[f"vprtempo_{kind}ensemble"].seeds
        assert len({seed + member for seed in seeds for member in range(5)}) == 15


def test_columns_name_published_datasets_and_what_stands_in_and_the_growth_asks_for_no_more_queries_than_places():
    columns = PAPER.columns
    published = {column.published for column in columns.values()} - {None}
    assert published == {dataset for _, dataset in PAPER.published.numbers}
    for column in columns.values():
        if column.stand_in_for is not None:
            assert columns[column.stand_in_for].stand_in_for is None
            assert "rendered" in f"{column.title} {column.remark}", column.name
    stand_in, real = columns["railway_vprsnn"], columns["nordland_vprsnn"]
    assert (stand_in.stand_in_for, stand_in.published) == ("nordland_vprsnn", real.published)
    assert stand_in.options[1:] == real.options[1:]  # the frames alone differ
    for size in PAPER.growth.sizes:
        column = PAPER.growth.column(size)
        asked = {name: int(value) for name, _, value in (text.partition("=") for text in column.options[-2:])}
        assert asked["dataset.places"] == size
        assert 0 < asked["dataset.query_places"] <= size * 9 / 11 + 1
    assert [PAPER.growth.column(n).options[-1][-3:] for n in (100, 27_000)] == ["=82", "300"]


@pytest.mark.parametrize(
    ("part", "value", "named"),
    [
        *((group, None, r"table\.yaml") for group in ("more_rows", "growth", "seeds")),
        ("seeds", [], r"table\.yaml"),
        ("rows.SAD.colour", "red", r"table\.yaml.*colour"),
        ("rows.SAD.boundary", "everything", "rows.SAD.*everything"),
        ("rows.SAD.training", "somehow", "rows.SAD.*somehow"),
        ("rows.SAD.seeds", [], "rows.SAD.*seeds"),
        ("columns.railway.stand_in_for", "moon", "column railway.*moon"),
    ],
)
def test_a_plan_that_lacks_a_part_or_means_nothing_is_refused_by_name(part, value, named, tmp_path):
    content, path = OmegaConf.load(PLAN), tmp_path / "table.yaml"
    content.pop(part) if value is None else OmegaConf.update(content, part, value)
    OmegaConf.save(content, path)
    with pytest.raises(BadInput, match=named):
        read_plan(path)
    with pytest.raises(BadInput, match=r"nowhere\.yaml"):
        read_plan(tmp_path / "nowhere.yaml")


PLUG_IN = {
    "rows": {"mine": {"name": "Mine", "method": "sad", "arguments": {"patch": 9}, "training": "none"}},
    "columns": {"short": {"title": "Short route", "options": ["dataset=synthetic", "dataset.places=12"]}},
}


def plugged_in(folder, **contents):
    """Return the folders of plug-ins, each with one file of the table, beside our own."""
    for provider, content in contents.items():
        (folder / provider / "table").mkdir(parents=True)
        (folder / provider / "table" / "more.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    return {"vprbench": ROOT / "conf", **{provider: folder / provider for provider in contents}}


def test_a_plug_in_brings_rows_and_columns_that_are_asked_for_by_name_and_others_are_refused(tmp_path, monkeypatch):
    folders = plugged_in(tmp_path, shelf=PLUG_IN)
    monkeypatch.setattr(registry, "find_conf_folders", lambda: folders)
    assert "short" not in [column.name for column in chosen().columns]
    here = chosen(rows=["SAD"], methods=["sad", "mine"], columns=["short"])
    (made,) = of_last_row(here)
    assert [row.name for row in here.rows] == ["SAD", "Mine"]
    assert (made.row.name, made.title, made.request.dataset["places"]) == ("Mine", "Short route", 12)
    assert made.request.changed == {"patch": 9}
    for option, name in ("rows", "Nobody"), ("methods", "nobody"), ("columns", "moon"):
        with pytest.raises(BadInput, match=f"{option}={name}"):
            chosen(**{option: [name]})


@pytest.mark.parametrize(
    ("content", "names"),
    [
        ({"rows": {"SAD": {"method": "sad"}}}, ["SAD", "shelf"]),
        ({"rows": {"x": {"method": "sad", "name": "VPRSNN (no threshold)"}}}, ["VPRSNN", "shelf"]),
        ({"columns": {"railway": {"title": "S", "options": []}}}, ["railway", "shelf"]),
        (PLUG_IN, ["mine", "shelf"]),
        ({"columns": {"x": {"title": "X", "options": [], "stand_in_for": "moon"}}}, ["more.yaml", "x", "moon"]),
        ({"growth": {}}, ["more.yaml", "growth"]),
        ({"rows": {"x": {"method": "sad", "colour": "red"}}}, ["more.yaml", "colour"]),
    ],
)
def test_a_plug_in_that_takes_a_name_or_means_nothing_is_refused(content, names, tmp_path):
    with pytest.raises(BadInput) as refused:
        add_plug_ins(PAPER, plugged_in(tmp_path, drawer=PLUG_IN, shelf=content))
    assert [name for name in names if name not in str(refused.value)] == []


@pytest.mark.parametrize(
    ("method", "seeds", "training", "asked"),
    [
        ("hog", (0,), "map", ("hog", {})),
        ("random_projection", (0, 1, 2), "map", ("random_projection", {})),
        ("vprsnn_all_neurons", (0, 1, 2), "own", ("vprsnn", {"hyperactive_threshold": 0})),
        ("vprsnn_ensemble", (0, 1, 2), "own", ("vprsnn_ensemble", {})),
    ],
)
def test_a_method_on_request_runs_once_a_seed_if_it_takes_one_and_its_yaml_says_whether_it_trains(
    method, seeds, training, asked
):
    here = chosen(rows=["VPRSNN"], methods=[method], columns=["nordland_64x32"], full=True)
    runs = of_last_row(here)
    assert (here.rows[-1].training, tuple(run.request.seed for run in runs)) == (training, seeds)
    assert all((run.request.method_name, run.request.changed) == asked for run in runs)


def test_columns_take_the_folder_of_their_frames_and_those_on_request_are_not_among_the_others(tmp_path):
    for given, columns in ((), "railway railway_winter"), (("nordland", "robotcar"), "nordland oxford_robotcar"):
        here = chosen(**dict.fromkeys(given, str(tmp_path)))
        assert " ".join(column.name for column in here.columns) == columns
    nordland, held_out = chosen(columns=["nordland_vprsnn", "nordland_64x32_held_out"], nordland=str(tmp_path)).columns
    assert (nordland.dataset["root"], nordland.dataset["protocol"]) == (str(tmp_path), "vprsnn")
    options = ("protocol", "places", "first_query_place", "query_places")
    assert [held_out.dataset[name] for name in options] == ["vprtempo", 2761, 600, 2761 - 600]
