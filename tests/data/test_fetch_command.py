"""The fetch command: what it lists, what it checks afterwards, and what it tells who has to register."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from little_download import COMPLETE, SPRING, get, little, spring, visible
from served_files import Server

from vprbench.data.fetch.command import fetch_command
from vprbench.data.fetch.entries import downloads
from vprbench.errors import NotThere

pytestmark = pytest.mark.usefixtures("on_the_net")


class TestCheck:
    @pytest.mark.parametrize(
        ("missing", "said"),
        [
            ([], "Checked as dataset=little:\nlittle is fine\nno black frame\n"),
            (["little"], "Checked as dataset=less:\nless is fine\nno black frame\n"),
            (["little", "less"], "dataset=little cannot run yet: summer is missing\n"),
        ],
    )
    def test_it_is_made_of_the_first_dataset_that_has_its_frames_and_its_lines_are_printed(
        self, server: Server, root: Path, capsys: pytest.CaptureFixture[str], missing: list[str], said: str
    ) -> None:
        def check(name: str, folder: Path) -> tuple[str, ...]:
            assert folder == root
            if name in missing:
                raise NotThere("summer is missing")
            return (f"{name} is fine", "no black frame")

        entry = little(parts={"spring": spring(server.serve("/spring", SPRING))}, datasets=("little", "less"))
        assert get(entry, root, check) == 0
        assert said in capsys.readouterr().out


class TestRegistration:
    ENTRY = little(register="Register at https://example.org, and put spring/ into {folder}.\n")

    def test_a_person_is_told_what_to_do(self, root: Path, capsys: pytest.CaptureFixture[str]) -> None:
        assert get(self.ENTRY, root) == 2
        printed = capsys.readouterr().out
        assert f"Register at https://example.org, and put spring/ into {root}.\n" in printed
        assert f"Nothing of that is in {root} yet." in printed
        assert not root.exists()

    @pytest.mark.parametrize(("complete", "code"), [(True, 0), (False, 2)])
    def test_what_the_person_put_there_is_checked(
        self, root: Path, capsys: pytest.CaptureFixture[str], complete: bool, code: int
    ) -> None:
        def check(name: str, folder: Path) -> tuple[str, ...]:
            if not complete:
                raise NotThere("1.png is missing")
            return ("2 frames, as expected",)

        (root / "spring").mkdir(parents=True)
        assert get(self.ENTRY, root, check) == code
        assert ("2 frames, as expected" if complete else "1.png is missing") in capsys.readouterr().out

    def test_the_parts_that_are_public_are_fetched(self, server: Server, root: Path) -> None:
        entry = little(register="Ask its authors.", parts={"lists": spring(server.serve("/lists", SPRING))})
        assert get(entry, root) == 2
        assert visible(root) == COMPLETE
        (root / "frames").mkdir()
        assert get(entry, root) == 0

    def test_public_parts_that_are_gone_do_not_keep_from_the_check(
        self, server: Server, root: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        entry = little(register="Ask its authors.", parts={"lists": spring(f"{server.url}/gone")})
        (root / "frames").mkdir(parents=True)
        assert get(entry, root, lambda name, folder: ("fine",)) == 0
        assert re.search(r"/gone answers 404 [^\n]*\n.*\nfine\n$", capsys.readouterr().out)


class TestCommand:
    def test_without_a_name_it_lists_what_there_is(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert fetch_command([]) == 0
        printed = capsys.readouterr().out
        assert "nordland: Nordland, a railway journey" in printed
        assert "spring (14.2 GB), fall (11.9 GB), summer (11.8 GB), winter (9.6 GB)" in printed
        assert "oxford_robotcar: " in printed
        assert printed.count("  licence: ") == len(downloads())

    def test_options_reach_the_fetch(self, root: Path, capsys: pytest.CaptureFixture[str]) -> None:
        assert fetch_command(["msls", f"root={root}"]) == 2
        assert f"images/ into\n   {root}; then run dataset=utm_folders" in capsys.readouterr().out
