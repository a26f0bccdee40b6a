"""The benchmark of speed: all it prints was measured, its floors count what they say, its exponents are right."""

from __future__ import annotations

import contextlib
import io
import json
import math
import re
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Self

import numpy as np
import numpy.typing as npt
import psutil
import pytest
import torch
from stopped_clock import Clock

from vprbench import progress
from vprbench.api.arrays import Places, Scores
from vprbench.api.images import Images
from vprbench.api.method import Method
from vprbench.cli import main
from vprbench.errors import BadInput
from vprbench.plugins.options import chosen
from vprbench.speed import bench, measure, training, vprsnn
from vprbench.speed.measure import AFTER, BEFORE, floor_laps, timed_fit
from vprbench.speed.route import Route
from vprbench.speed.settings import QUICK, Settings

PLACES, MODULES, PLACES_OF_A_MODULE, PIXELS = 20, 2, 10, 12 * 12  # of quick=true
FEATURES = 2 * PIXELS


@dataclass(frozen=True)
class Done:
    code: int
    printed: str
    text: str
    raw: dict[str, Any]


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Done:
    results = tmp_path_factory.mktemp("bench")
    printed = io.StringIO()
    enough = SimpleNamespace(**{**vars(psutil), "virtual_memory": lambda: SimpleNamespace(available=1e15)})
    with (
        pytest.MonkeyPatch.context() as patch,
        contextlib.redirect_stdout(printed),
        contextlib.redirect_stderr(io.StringIO()),
    ):
        for module in (training, vprsnn):
            patch.setattr(module, "psutil", enough)  # less is measured where memory is short
        code = main(["bench", "quick=true", "threads=1", f"results={results}"])
    raw = json.loads((results / "bench.json").read_text())
    return Done(code, printed.getvalue(), (results / "bench.md").read_text(), raw)


def rows(text: str, heading: str) -> list[list[str]]:
    """The cells of the tables under a heading, without their heads."""
    section = text.split(f"## {heading}")[1].split("\n## ")[0]
    lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in section.splitlines() if line[:1] == "|"]
    return [row for number, row in enumerate(lines) if not row[0].startswith(":--") and not heads(lines, number)]


def heads(lines: list[list[str]], number: int) -> bool:
    return number + 1 < len(lines) and lines[number + 1][0].startswith(":--")


def numbers(cells: list[str]) -> list[float]:
    return [float(cell.strip("x").replace(",", "")) for cell in cells]


SECTIONS = {
    "A training step": ["paper", "reference"],
    "The fit that users ask for": ["paper", "reference"],
    "Reading frames": ["40x24"],
    "Reading names": ["40"] * 2,
    "Preprocessing": ["64x32"] * 4 + ["40x24"] * 4,
    "Queries at": [
        "sad",
        *(f"vprtempo{kind} {rules}" for kind in ("", "_int8") for rules in ("paper", "reference")),
        "vprtempo_ensemble reference members=2",
    ],
    "Matching beside": ["exact search", "exact search", "exact search, best 100", "sad"],
    "Growth with": [*["paper"] * 3, *["reference"] * 3] * 2,
    "A module of VPRSNN": ["vprsnn", "vprsnn_fast"] * 2,
    "Queries to many modules": ["1", "3"],
}


def test_every_section_holds_its_rows_of_finite_numbers(done: Done) -> None:
    assert done.code == 0
    assert done.printed.startswith(done.text)
    assert "quick=true" in done.text
    assert [line[3:] for line in done.text.splitlines() if line.startswith("## ")][-1] == "Machine"
    for heading, first_cells in SECTIONS.items():
        found = rows(done.text, heading)
        assert [row[0] for row in found] == first_cells
        for row in found:
            assert all(row)
            assert any(re.search(r"\d", cell) for cell in row[1:])
            assert not any(re.search(r"\b(nan|inf|None|failed)\b", cell) for cell in row)


def test_the_machine_its_libraries_and_its_load_are_named(done: Done) -> None:
    machine = done.text.split("## Machine")[1]
    assert re.search(r"1 of \d+ cores", machine)
    assert re.search(r"numpy \d+\.\d+", machine)
    assert re.search(r"start: training \d+\.\d\d, fits \d", machine)


def test_both_claims_of_the_paper_stand_beside_a_measured_growth(done: Done) -> None:
    for subject, claim, n_exponents in (("fits", "O(n)", 2), ("queries", "O(log n)", 4)):
        (sentence,) = (line for line in done.text.splitlines() if line.startswith(f"Measured {subject}:"))
        assert claim in sentence
        assert "from 10 to 40 places (n grows 4x, log n 1.6x)" in sentence
        assert len(re.findall(r"as n\^-?\d+\.\d\d \[-?\d+\.\d\d, -?\d+\.\d\d\]", sentence)) == n_exponents


def test_the_json_holds_every_lap(done: Done) -> None:
    for cell in done.raw["training"]:
        assert {engine: len(fits) for engine, fits in cell["fits"].items()} == {"readable": 2, "fused": 2}
        assert cell["steps"] == 2 * PLACES_OF_A_MODULE
    for cell in (*done.raw["queries"], *done.raw["training"]):
        assert len(cell["floor_seconds"]) >= 20
        assert min(cell["floor_seconds"]) > 0
    for cell in done.raw["preprocessing"]:
        assert len(cell["seconds"]["fused"]) == len(cell["seconds"]["readable"]) >= 2
    for cell in (*done.raw["queries"], *done.raw["scaling"]):
        streaming, offline = cell["rates"]["streaming_laps"], cell["rates"]["offline_laps"]
        assert len(streaming["encode"]) == len(streaming["match"]) >= 4
        assert [laps["images_per_call"] for laps in offline] == [1, 4]
        assert all(lap > 0 for laps in (streaming, *offline) for lap in (*laps["encode"], *laps["match"]))


def test_printed_rates_are_those_of_the_laps(done: Done) -> None:
    cell = done.raw["queries"][0]
    laps = cell["rates"]["streaming_laps"]
    totals = sorted(e + m for e, m in zip(laps["encode"], laps["match"], strict=True))
    hz = 1 / ((totals[(len(totals) - 1) // 2] + totals[len(totals) // 2]) / 2)
    assert f"/ {hz:,.0f}" in rows(done.text, "Queries at")[0][1]


def test_matching_is_compared_with_the_floor(done: Done) -> None:
    for cell, row in zip(done.raw["queries"], rows(done.text, "Queries at"), strict=True):
        ratio = np.median(cell["rates"]["streaming_laps"]["match"]) / np.median(cell["floor_seconds"])
        assert numbers(row[4:5]) == pytest.approx([ratio], rel=0.006)


def test_a_training_step_is_compared_with_the_floor_and_with_the_other_engine(done: Done) -> None:
    for cell, row in zip(done.raw["training"], rows(done.text, "A training step"), strict=True):
        step = {}
        for engine, fits in cell["fits"].items():
            training = [sum(s for stage, s in fit["stages"].items() if stage.startswith("training")) for fit in fits]
            step[engine] = 1000 * np.median(training) / cell["steps"]
        floor = 1000 * np.median(cell["floor_seconds"])
        readable, fused = step["readable"], step["fused"]
        wanted = [readable, fused, readable / fused, floor, readable / floor, fused / floor]
        assert numbers(row[4:]) == pytest.approx(wanted, rel=0.006)


def test_matching_is_compared_with_a_library_by_medians_of_calls_in_turn(done: Done) -> None:
    cells, found = done.raw["search"], rows(done.text, "Matching beside")
    assert [(cell["library"], cell["images_per_call"]) for cell in cells] == [
        ("faiss.IndexFlatIP", 1),
        ("faiss.IndexFlatIP", 4),
        ("faiss.IndexFlatIP", 300),
        ("torch.cdist", 1),
    ]
    for cell, row in zip(cells, found, strict=True):
        assert min(len(cell["seconds"]), len(cell["library_seconds"])) >= 2
        ours, library = (np.median(cell[name]) for name in ("seconds", "library_seconds"))
        hz = cell["images_per_call"] / ours
        assert numbers(row[3:7]) == pytest.approx([1000 * ours, hz, 1000 * library, ours / library], rel=0.006)


def test_a_floor_counts_the_bytes_of_the_weights(done: Done) -> None:
    each_module = FEATURES * PIXELS + FEATURES + FEATURES + FEATURES * PLACES_OF_A_MODULE + PLACES_OF_A_MODULE
    matrix = PLACES * PIXELS
    assert {cell["method"].split(" members")[0]: cell["floor_bytes"] for cell in done.raw["queries"]} == {
        "sad": 2 * PLACES * PIXELS,
        "vprtempo paper": MODULES * each_module * 4,
        "vprtempo reference": matrix * 4,
        "vprtempo_int8 paper": MODULES * each_module,
        "vprtempo_int8 reference": matrix,
        "vprtempo_ensemble reference": matrix * 4,
    }
    assert {cell["floor_bytes"] for cell in done.raw["training"]} == {2 * each_module * 4}


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    clock.replaces_those_of([measure], monkeypatch)
    return clock


@pytest.mark.parametrize("touch", ["read", "pass"])
def test_a_floor_grows_with_the_bytes(touch: Any, clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
    class Buffer:
        """Numbers of four bytes, of which a nanosecond reads one byte and two nanoseconds change it."""

        def __init__(self, count: int, device: str) -> None:
            self.n_bytes = 4 * count

        def sum(self) -> None:
            clock.spend(self.n_bytes / 1e9)

        def mul_(self, factor: float) -> None:
            clock.spend(2 * self.n_bytes / 1e9)

    monkeypatch.setattr(torch, "ones", Buffer)
    for n_bytes in (10_000, 40_000_000):
        each = n_bytes / 1e9 * {"read": 1, "pass": 2}[touch]
        assert floor_laps(touch, n_bytes, "cpu", 0.0) == pytest.approx([each] * 20)


def test_the_stages_of_a_fit_add_up_to_its_time(done: Done) -> None:
    for cell in done.raw["fits"]:
        stages = cell["fit"]["stages"]
        assert list(stages) == [BEFORE, "training features", "training places", AFTER]
        assert min(stages.values()) >= 0
        assert sum(stages.values()) == pytest.approx(cell["fit"]["seconds"], rel=1e-3)


@dataclass
class Slow(Method):
    """Reports its stages at known times."""

    clock: Clock

    def fit(self, references: Images, places: Places) -> Self:
        self.clock.spend(0.02)
        for stage, seconds in (("one", 0.03), ("two", 0.06)):
            progress.report(stage, 0.0)
            self.clock.spend(seconds)
            progress.report(stage, 1.0)
        self.clock.spend(0.01)
        return self

    def encode(self, images: Images) -> npt.NDArray[np.float32]:
        raise NotImplementedError

    def match(self, codes: npt.NDArray[np.float32]) -> Scores:
        raise NotImplementedError


def test_a_stage_lasts_from_its_first_report_to_that_of_the_next(clock: Clock) -> None:
    heard: list[str] = []
    with progress.listening(lambda stage, _: heard.append(stage)):
        fit = timed_fit("slow", Slow(clock), *Route.drawn(2, 4, 4, 0).references(2, 1), "cpu")
    assert fit.stages == pytest.approx({BEFORE: 0.02, "one": 0.03, "two": 0.06, AFTER: 0.01})
    assert list(fit.stages) == [BEFORE, "one", "two", AFTER]
    assert fit.seconds == pytest.approx(0.12)
    assert fit.training_seconds == fit.stages["one"] + fit.stages["two"]
    assert heard == ["slow: one", "slow: one", "slow: two", "slow: two"]


def quick_settings(*options: str) -> Settings:
    return chosen(Settings, ["quick=true", "threads=1", *options], QUICK)


def test_options_replace_what_quick_chooses_whatever_their_order() -> None:
    for options in (["quick=true", "rounds=7"], ["rounds=7", "quick=true"]):
        settings = chosen(Settings, options, QUICK)
        assert (settings.rounds, settings.places) == (7, QUICK["places"])


def test_an_exponent_has_students_interval_if_there_are_three_sizes() -> None:
    def cells(*sizes: int) -> Any:
        return [SimpleNamespace(places=size) for size in sizes]

    # log n = 0, 1, 2 and log t = 0, 0, 1: slope 1/2, residuals 1/6, -1/3, 1/6; Student 12.7062
    seconds = {1: 1.0, 10: 1.0, 100: 10.0}
    half = 12.7062 * math.sqrt(1 / 12)

    def time(cell: Any) -> float:
        return seconds[cell.places]

    assert bench.grown(cells(1, 10, 100), time) == f"0.50 [{0.5 - half:.2f}, {0.5 + half:.2f}] (3 sizes)"
    assert bench.grown(cells(10, 100), time) == "1.00 (2 sizes, no interval)"
    assert bench.grown(cells(10), time) == "1 sizes: needs two"


def test_what_cannot_be_measured_says_why_in_its_cell_and_no_other_section_is_told() -> None:
    def make(*_: object, **__: object) -> Method:
        raise MemoryError("only 3 bytes are left\nand a second line")

    settings = quick_settings("sizes=[10]", "sections=[training,fits,queries,search,scaling]")
    report = bench.measure(settings, make)
    told = bench.text_of(report)
    assert [len(report.sections[name]) for name in settings.sections] == [2, 2, 6, 4, 2]
    failures = report.failures
    assert len(failures) == 2 + 2 + 6 + 1 + 2
    assert {each.reason for each in failures} == {
        "MemoryError: only 3 bytes are left",
        "its network could not be trained, see above",
    }
    assert all(each.reason in told for each in failures)
    assert "Measured fits" not in told
    assert [line.split()[1] for line in told.splitlines() if line.startswith("## ")] == [
        *("A", "The", "Queries", "Matching", "Growth", "Machine")
    ]


def test_a_size_for_which_memory_is_missing_is_not_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    smaller: Any = SimpleNamespace(places=100, fits=[SimpleNamespace(peak_memory_bytes=3e9, memory_before_bytes=1e9)])
    monkeypatch.setattr(training.psutil, "virtual_memory", lambda: SimpleNamespace(available=5e9))
    training.check_memory(249, smaller)
    with pytest.raises(BadInput, match=r"100 places took 2\.0 GB, and 5\.0 GB are free"):
        training.check_memory(251, smaller)


@pytest.fixture
def in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(
    ("option", "wanted"),
    [
        ("size=[100]", "option size is unknown: did you mean sizes?"),
        ("sections=[serch]", "sections=['serch']: give some of"),
        ("vprsnn_modules=[]", "vprsnn_modules=[]: give"),
        ("rounds=0", "rounds=0: give at least 1"),
        ("sizes=[]", "sizes=[]: give"),
        ("frame=[360]", "frame=[360]: give height and width"),
        ("threads=9999", "threads=9999: this process may use 1 to"),
        ("device=tpu", "device=tpu is unknown: give cpu, cuda or cuda:1"),
        ("sample=0", "timing.sample=0"),
        ("seed=-1", "seed=-1: give 0 or a larger number"),
    ],
)
@pytest.mark.usefixtures("in_a_folder_of_its_own")
def test_bad_options_are_refused_by_name(option: str, wanted: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", option]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("vprbench: ")
    assert captured.err.count("\n") == 1
    assert wanted in captured.err
    assert not list(Path().iterdir())


def test_a_traverse_differs_from_the_first_by_a_little_noise_and_from_every_other() -> None:
    route = Route.drawn(30, 32, 64, 0)
    references, places = route.references(30, 3)
    shown = np.stack(list(references)).astype(int)[..., 0]
    assert places.tolist() == [*range(30)] * 3
    for first, second in ((0, 30), (0, 60), (30, 60)):
        apart = np.abs(shown[first : first + 30] - shown[second : second + 30])
        assert 0 < apart.mean() < 10
        assert apart.max() <= 20
    assert np.abs(shown[0] - shown[1]).mean() > 30


def test_queries_are_noisy_frames_of_places_spread_over_the_route() -> None:
    route = Route.drawn(30, 32, 64, 0)
    queries, places = route.queries(21, 5)
    assert places.tolist() == [0, 5, 10, 15, 20]
    for image, place in zip(queries, places, strict=True):
        assert 0 < np.abs(image[..., 0].astype(int) - route.frames[place]).mean() < 10
