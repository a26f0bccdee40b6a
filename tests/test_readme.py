"""What the README shows works as it stands there."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    for part in ("vprbench", "methods", "datasets", "conf"):
        shutil.copytree(ROOT / part, tmp_path / part)
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    return tmp_path


def test_the_method_in_two_files_keeps_the_contract(checkout: Path) -> None:
    for path, language in (("methods/darkness.py", "python"), ("conf/method/darkness.yaml", "yaml")):
        shown = re.search(rf"`{path}`:\n\n```{language}\n(.*?)```", README, re.DOTALL)
        assert shown, path
        (checkout / path).write_text(shown.group(1), encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "vprbench", "check", "method=darkness", "method.cells=4"],
        cwd=checkout,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert "0 broken" in done.stdout, done.stdout + done.stderr


def test_the_files_it_names_exist() -> None:
    named = re.findall(r"`((?:methods|tests|docs|conf|vprbench)/[\w./-]+)`|\((docs/[\w.]+)\)", README)
    missing = [path for pair in named for path in pair if path and not (ROOT / path).exists()]
    assert missing == ["methods/darkness.py", "conf/method/darkness.yaml"]


def test_every_target_of_the_makefile_is_explained() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    (phony,) = re.findall(r"^\.PHONY: (.*)$", makefile, re.MULTILINE)
    assert set(phony.split()) == set(re.findall(r"^([a-z-]+):.*## \S", makefile, re.MULTILINE))


def test_what_it_shows_of_a_run_is_filled_in() -> None:
    for name in ("table", "run"):
        shown = re.search(rf"<!-- {name} -->(.*?)<!-- /{name} -->", README, re.DOTALL)
        assert shown
        assert "vprtempo" in shown.group(1)
