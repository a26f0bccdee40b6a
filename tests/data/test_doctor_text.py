"""What the doctor's command prints, and its exit code."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from doctored import dataset_of, healthy

from vprbench.api.dataset import Dataset
from vprbench.data.doctor import Finding, as_text, command
from vprbench.errors import NotThere


def test_long_text_is_broken_between_words_alone() -> None:
    path = "/data/a-very-long-path-that-must-stay-whole/" * 3
    text = as_text("little", [Finding("warning", "files", f"{'word ' * 30}{path}", "")])
    assert path in text
    assert all(len(line) <= 110 or path in line for line in text.splitlines())


def test_a_healthy_dataset_exits_with_0_and_says_that_nothing_is_wrong(tmp_path: Path) -> None:
    winter, summer = healthy(tmp_path)
    lines: list[str] = []
    code = command("little", lambda: dataset_of([winter], summer), lines.append)
    assert code == 0
    assert lines[0].endswith("nothing is wrong: 0 errors, 0 warnings, 1 note")


@pytest.mark.parametrize("counts", [(55,), ()], ids=["a warning", "an error"])
def test_errors_and_warnings_exit_with_1(tmp_path: Path, counts: tuple[int, ...]) -> None:
    winter, summer = healthy(tmp_path)
    if not counts:
        (winter / "000.png").unlink()
    assert command("little", lambda: dataset_of([winter], summer, counts=counts), lambda _: None) == 1


def test_a_dataset_that_cannot_be_built_is_the_finding() -> None:
    def build() -> Dataset:
        raise NotThere("winter/000.png is missing: get the frames")

    lines: list[str] = []
    assert command("little", build, lines.append) == 1
    assert "error     dataset: winter/000.png is missing: get the frames" in lines[0]


def test_json_holds_the_same_findings(tmp_path: Path) -> None:
    winter, summer = healthy(tmp_path)
    (summer / "007.png").write_bytes(b"")
    lines: list[str] = []
    code = command("little", lambda: dataset_of([winter], summer), lines.append, "json")
    found = json.loads(lines[0])
    assert code == 1
    assert [set(finding) for finding in found] == [{"level", "check", "text", "advice"}] * 2
    assert [finding["check"] for finding in found] == ["files", "alignment"]
