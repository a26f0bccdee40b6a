"""The published ways to ask Nordland, each by its name: which frames, which are right, and no two in one column."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import hypot
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vprbench.api.dataset import Dataset
from vprbench.datasets.nordland import published_frames
from vprbench.paper.plan import read_plan
from vprbench.plugins import registry
from vprbench.run import compose

NAMES = ("nordland", "nordland_vprsnn", "nordland_patchnetvlad", "nordland_27k", "nordland_vprbench")
WHOLE_MAPS = NAMES[2:]
FRAMES = [f"images-{frame:05d}.png" for frame in published_frames()]


def config(*options: str) -> dict[str, Any]:
    return dict(compose.composed(list(options))["dataset"])


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four seasons of empty files: nothing is read."""
    folder = tmp_path_factory.mktemp("nordland")
    (folder / "spring").mkdir()
    for name in FRAMES:
        (folder / "spring" / name).touch()
    for season in ("summer", "fall", "winter"):
        (folder / season).symlink_to(folder / "spring")
    return folder


@pytest.fixture(scope="module")
def datasets(root: Path) -> Mapping[str, Dataset]:
    return {name: registry.make_dataset({**config(f"dataset={name}"), "root": str(root)}) for name in NAMES}


@pytest.mark.parametrize(
    ("name", "queries", "places", "references", "query"),
    [
        ("nordland", 2700, 3300, ["spring", "fall"], "summer"),
        ("nordland_vprsnn", 2700, 2700, ["spring", "fall"], "summer"),
        ("nordland_patchnetvlad", 27_592, 27_592, ["summer"], "winter"),
        ("nordland_27k", 27_592, 27_592, ["summer"], "winter"),
        ("nordland_vprbench", 2760, 27_592, ["winter"], "summer"),
    ],
)
def test_each_asks_as_many_queries_of_as_many_places_in_the_seasons_that_are_published(
    datasets: Mapping[str, Dataset], name: str, queries: int, places: int, references: list[str], query: str
) -> None:
    dataset = datasets[name]
    assert (len(dataset.queries), dataset.n_places) == (queries, places)
    assert len(dataset.references) == places * len(references)
    assert (dataset.protocol["references"], dataset.protocol["query"]) == (references, query)
    assert [folder.path.name for folder in dataset.folders] == [query, *references]


@pytest.mark.parametrize("name", WHOLE_MAPS)
def test_the_map_of_the_others_is_the_whole_list_in_its_order(datasets: Mapping[str, Dataset], name: str) -> None:
    assert [*datasets[name].references.names] == FRAMES
    assert [*datasets[name].queries.names] == FRAMES[:: 10 if name == "nordland_vprbench" else 1]
    assert datasets[name].places.tolist() == [*range(27_592)]
    assert datasets[name].held_out is None


def test_vprsnn_asks_all_places_but_the_600_that_its_authors_draw(datasets: Mapping[str, Dataset]) -> None:
    drawn = {*np.random.RandomState(42).permutation(3300)[:600].tolist()}
    left = [FRAMES[8 * place] for place in range(3300) if place not in drawn]
    dataset = datasets["nordland_vprsnn"]
    assert [*dataset.references.names] == left * 2
    assert [*dataset.queries.names] == left
    assert dataset.held_out is not None
    assert [*dataset.held_out.queries.names] == [FRAMES[8 * place] for place in sorted(drawn)]


# Ground truth, from what each publishes, asked of every frame of the map

METRES_A_FRAME = 25 / 10.5
BY_SOURCE: dict[str, Callable[[int, int], bool]] = {
    "nordland_patchnetvlad": lambda query, frame: hypot(query - frame, query - frame) <= 10,  # frame i at (i, i)
    "nordland_27k": lambda query, frame: abs(query * METRES_A_FRAME - frame * METRES_A_FRAME) <= 25,
    "nordland_vprbench": lambda query, frame: frame in (query - 1, query, query + 1),
}


@pytest.mark.parametrize("name", WHOLE_MAPS)
def test_right_are_the_frames_that_the_source_counts_as_right(datasets: Mapping[str, Dataset], name: str) -> None:
    dataset = datasets[name]
    n_queries = len(dataset.queries)
    stride = {"nordland_vprbench": 10}.get(name, 1)
    for number in (*range(12), *range(500, n_queries, 1499), *range(n_queries - 12, n_queries)):
        right = [frame for frame in range(27_592) if BY_SOURCE[name](number * stride, frame)]
        assert dataset.positives[number].tolist() == right


# What is told of them


def test_the_protocol_of_each_is_named_with_all_that_it_selects(datasets: Mapping[str, Dataset]) -> None:
    told = {name: dict(dataset.protocol) for name, dataset in datasets.items()}
    assert [protocol["protocol"] for protocol in told.values()] == [
        "vprtempo",
        "vprsnn",
        "patchnetvlad",
        "27k",
        "vprbench",
    ]
    assert told["nordland_vprbench"] == {
        "protocol": "vprbench",
        "references": ["winter"],
        "query": "summer",
        "stride": 1,
        "places": 27_592,
        "query_places": 2760,
        "first_query_place": 0,
        "query_stride": 10,
        "reference_places": 27_592,
        "held_out_places": 0,
        "tolerance_places": 1,
        "frame_multiple": 1,
    }
    assert [told[name]["tolerance_places"] for name in NAMES] == [0, 0, 7, 10, 1]


def test_patch_netvlads_tolerance_is_told_with_every_run(datasets: Mapping[str, Dataset]) -> None:
    (note,) = datasets["nordland_patchnetvlad"].notes
    assert note.startswith("Patch-NetVLAD names a tolerance of 10 frames; its published positions")
    assert note.endswith("right are here frames up to 7 away")
    assert all(not datasets[name].notes for name in NAMES if name != "nordland_patchnetvlad")


def test_vprsnns_by_its_name_is_the_papers_with_another_protocol() -> None:
    assert config("dataset=nordland_vprsnn") == config("dataset=nordland", "dataset.protocol=vprsnn")


# Columns


@pytest.mark.parametrize("name", WHOLE_MAPS)
def test_columns_of_the_others_are_shown_on_request_and_beside_no_published_numbers(name: str) -> None:
    column = read_plan(registry.conf_folders()["vprbench"] / "table.yaml").columns[name]
    assert column.on_request
    assert column.published is None


@pytest.mark.parametrize("name", WHOLE_MAPS)
def test_modules_of_vprtempo_are_nearly_of_one_size_there(name: str) -> None:
    column = read_plan(registry.conf_folders()["vprbench"] / "table.yaml").columns[name]
    sizes = [fits["max_module"] for fits in column.fits.values()]
    assert all(size <= 1100 and size - 27_592 % size < 0.05 * size for size in sizes)
