"""The benchmark of speed: all it prints was measured, its floors count what they say, its exponents are right."""

from __future__ import annotations

import contextlib
import io
import json
import re
from types import SimpleNamespace

import numpy as np
import psutil
import pytest

from vprbench.cli import main
from vprbench.plugins.options import chosen
from vprbench.runs import machine
from vprbench.speed import bench, events, files, frames, training, vprsnn
from vprbench.speed.settings import QUICK, Settings

pytestmark = pytest.mark.extended  # a benchmark takes its time
PLACES, MODULES, PLACES_OF_A_MODULE, PIXELS = 20, 2, 10, 12 * 12  # of quick=true
FEATURES = 2 * PIXELS


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """All sections at their smallest: what is printed and written, and how many cores threads were pinned to."""
    results, printed, cores = tmp_path_factory.mktemp("bench"), io.StringIO(), []
    enough = SimpleNamespace(**{**vars(psutil), "virtual_memory": lambda: SimpleNamespace(available=1e15)})
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(printed):
        patch.setenv("VPRBENCH_HASHES", "")  # which measuring sets, as it does VPRBENCH_EVENTS
        patch.setenv("VPRBENCH_EVENTS", "")
        patch.setattr(files, "_SETTLED", 0)
        patch.setattr(machine, "pin_threads", cores.append)
        patch.setattr("gc.collect", int)  # which takes longer than all that is measured
        for module in (training, vprsnn):
            patch.setattr(module, "psutil", enough)  # less is measured where memory is short
        for module in (frames, files, events):
            patch.setattr(module, "in_own_process", lambda call, *given: call(*given))
        assert main(["bench", "quick=true", "threads=2", "sizes=[10,40]", f"results={results}"]) == 0
    raw, text = json.loads((results / "bench.json").read_text()), (results / "bench.md").read_text()
    assert printed.getvalue().startswith(text)
    return SimpleNamespace(text=text, raw=raw, cores=cores)


def rows(text, heading):
    """The cells of the tables under a heading, without their heads."""
    section = text.split(f"## {heading}")[1].split("\n## ")[0]
    lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in section.splitlines() if line[:1] == "|"]
    heads = {number - 1 for number, line in enumerate(lines) if line[0].startswith(":--")}
    return [line for number, line in enumerate(lines) if not heads & {number, number - 1}]


def numbers(cells):
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
    "Growth with": [*["paper"] * 2, *["reference"] * 2, *["paper"] * 3, *["reference"] * 3],
    "A module of VPRSNN": ["vprsnn", "vprsnn_fast"] * 2,
    "Queries to many modules": ["1", "1", "3", "3"],
}


def test_every_section_holds_its_rows_of_finite_numbers_and_the_papers_claims_beside_a_measured_growth(done):
    for heading, first_cells in SECTIONS.items():
        found = rows(done.text, heading)
        assert [row[0] for row in found] == first_cells
        assert all(all(row) and re.search(r"\d", "".join(row[1:])) for row in found)
        assert not re.search(r"\b(nan|inf|None|failed)\b", str(found))
    assert re.search(r"start: training \d+\.\d\d, fits \d", done.text.split("## Machine")[1])
    for subject, claim, n_exponents in (("fits", "O(n)", 2), ("queries", "O(log n)", 4)):
        (sentence,) = (line for line in done.text.splitlines() if line.startswith(f"Measured {subject}:"))
        assert claim in sentence
        assert "from 10 to 40 places (n grows 4x, log n 1.6x)" in sentence
        assert len(re.findall(r"as n\^-?\d+\.\d\d \(2 sizes, no interval\)", sentence)) == n_exponents


def test_printed_rates_and_ratios_to_floors_and_libraries_are_those_of_the_laps(done):
    raw, queries = done.raw, rows(done.text, "Queries at")
    laps = raw["queries"][0]["rates"]["streaming_laps"]
    assert f"/ {1 / np.median(np.add(laps['encode'], laps['match'])):,.0f}" in queries[0][1]
    for cell, row in zip(raw["queries"], queries, strict=True):
        ratio = np.median(cell["rates"]["streaming_laps"]["match"]) / np.median(cell["floor_seconds"])
        assert numbers(row[4:5]) == pytest.approx([ratio], rel=0.006)
    for cell, row in zip(raw["training"], rows(done.text, "A training step"), strict=True):
        trained = {
            engine: np.median([sum(s for stage, s in fit["stages"].items() if stage[:8] == "training") for fit in fits])
            for engine, fits in cell["fits"].items()
        }
        readable, fused = (1000 * trained[engine] / cell["steps"] for engine in ("readable", "fused"))
        floor = 1000 * np.median(cell["floor_seconds"])
        wanted = [readable, fused, readable / fused, floor, readable / floor, fused / floor]
        assert numbers(row[4:]) == pytest.approx(wanted, rel=0.006)
    asked = [*(("faiss.IndexFlatIP", count) for count in (1, 4, 300)), ("torch.cdist", 1)]
    assert [(cell["library"], cell["images_per_call"]) for cell in raw["search"]] == asked
    for cell, row in zip(raw["search"], rows(done.text, "Matching beside"), strict=True):
        ours, library = (np.median(cell[name]) for name in ("seconds", "library_seconds"))
        hz = cell["images_per_call"] / ours
        assert numbers(row[3:7]) == pytest.approx([1000 * ours, hz, 1000 * library, ours / library], rel=0.006)


def test_a_floor_counts_the_bytes_of_the_weights(done):
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


def test_what_cannot_be_measured_says_why_in_its_cell_and_no_other_section_is_told(monkeypatch):
    def make(*_, **__):
        raise MemoryError("only 3 bytes are left\nand a second line")

    monkeypatch.setattr(machine, "canary_seconds", lambda: 1.0)
    monkeypatch.setattr("gc.collect", int)
    few = ["search_references=20", "search_queries=5", "search_dimensions=4"]
    options = ["threads=1", "quick=true", "sizes=[10]", "sections=[training,fits,queries,search,scaling]", *few]
    report = bench.measure(settings := chosen(Settings, options, QUICK), make)
    told = bench.to_text(report)
    assert [len(report.sections[name]) for name in settings.sections] == [2, 2, 6, 4, 2]
    failures = report.failures
    assert len(failures) == 2 + 2 + 6 + 1 + 2
    reasons = {"MemoryError: only 3 bytes are left", "its network could not be trained, see above"}
    assert {each.reason for each in failures} == reasons
    assert all(each.reason in told for each in failures)
    heads = [line.split()[1] for line in told.splitlines() if line.startswith("## ")]
    assert heads == ["A", "The", "Queries", "Matching", "Growth", "Machine"]


def test_bad_options_are_refused_by_name(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    of_lists = ("size=[100]", "sections=[serch]", "sizes=[]", "frame=[360]")
    for option in (*of_lists, "rounds=0", "threads=9999", "device=tpu", "sample=0", "minimum_seconds=-1"):
        assert main(["bench", option]) == 2
        captured = capsys.readouterr()
        assert captured.out == ""
        assert re.fullmatch(rf"vprbench: .*\b{option.partition('=')[0]}\b.*\n", captured.err)
