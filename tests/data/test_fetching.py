"""Fetching: a dataset gets into its folder whatever server, archive and disk do, or nothing changes there."""

from __future__ import annotations

import hashlib
import logging
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from archive_files import special, tarred, zipped
from filelock import FileLock
from little_download import (
    CHUNK,
    COMPLETE,
    NOISE,
    PATIENCE,
    SHA256,
    SPRING,
    SUMMER,
    get,
    little,
    recorded,
    spring,
    visible,
)
from served_files import Server

from vprbench.data.fetch import command
from vprbench.data.fetch.command import Settings, fetch
from vprbench.data.fetch.entries import Held, Part
from vprbench.errors import BadInput, NotThere
from vprbench.progress import listening
from vprbench.storage.unpack import Wanted

pytestmark = pytest.mark.usefixtures("on_the_net")


def test_a_dataset_gets_into_its_folder_with_a_record_and_is_not_asked_for_again(
    server: Server, root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    url = server.serve("/spring", SPRING)
    entry = little(parts={"spring": spring(url)})
    assert get(entry, root, keep_archives=True) == 0
    assert (root / "archives" / "spring.zip").read_bytes() == SPRING
    assert (root / "spring" / "1.png").read_bytes() == NOISE
    record = recorded(root)["spring"]
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", record.pop("fetched"))
    assert record == {"url": url, "bytes": len(SPRING), "sha256": SHA256, "licence": "CC BY 4.0"}
    printed = capsys.readouterr().out
    assert f"SHA-256 {SHA256} (none is stated" in printed
    assert f"{root / 'spring'}: 2 files\n" in printed
    server.asked.clear()
    assert get(entry, root) == 0
    assert server.asked == []
    assert "CC BY 4.0" in capsys.readouterr().out


def test_a_dataset_gets_to_where_runs_look_for_it_without_its_archive(
    server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("VPRBENCH_DATA", str(tmp_path / "all"))
    entry = little(parts={"spring": spring(server.serve("/spring", SPRING))})
    assert fetch(entry, Settings(), timeout_seconds=PATIENCE, pause_seconds=0.0) == 0
    assert visible(tmp_path / "all" / "little") == COMPLETE


def test_a_file_that_is_no_archive_is_kept_as_it_is(server: Server, root: Path) -> None:
    wanted = Wanted(plain=True, into="drive", unpacked_bytes=len(NOISE))
    part = Part(file="drive.h5", urls=(server.serve("/drive", NOISE),), unpack=wanted, holds={"drive": Held(files=1)})
    assert get(little(parts={"drive": part}), root) == 0
    assert (root / "drive" / "drive.h5").read_bytes() == NOISE


def test_named_parts_or_the_usual_ones_that_are_not_there_are_fetched(server: Server, root: Path) -> None:
    summer = Part(
        "summer.tar.gz", (server.serve("/summer", SUMMER),), Wanted(unpacked_bytes=100), {"summer": Held(files=2)}
    )
    parts = {"spring": spring(server.serve("/spring", SPRING)), "summer": summer}
    get(little(parts=parts, default=("summer",)), root)
    assert visible(root) == ["fetched.json", "summer", "summer/1.png", "summer/2.png"]
    get(little(parts=parts), root, parts=["summer"])
    assert {asked.path for asked in server.asked} == {"/summer"}
    server.asked.clear()
    get(little(parts=parts), root)
    assert {asked.path for asked in server.asked} == {"/spring"}
    assert sorted(recorded(root)) == ["spring", "summer"]
    with pytest.raises(BadInput, match="sumer: did you mean summer"):
        get(little(parts=parts), root, parts=["sumer"])


@pytest.mark.parametrize(
    ("wrong", "stated"),
    [
        (None, {}),
        (zipped({"spring/1.png": b"another"}), {"sha256": SHA256}),
        (SPRING[:-CHUNK], {}),
        (SPRING, {"stalls": True}),
    ],
    ids=["gone", "another file", "damaged", "stalls"],
)
def test_the_next_address_is_tried_where_a_file_is(
    server: Server, root: Path, wrong: bytes | None, stated: dict[str, Any], caplog: pytest.LogCaptureFixture
) -> None:
    stalls = {"stalls_after": 0} if stated.pop("stalls", False) else {}
    first = f"{server.url}/gone" if wrong is None else server.serve("/wrong", wrong, **stalls)
    url = server.serve("/spring", SPRING)
    get(little(parts={"spring": spring(first, url, **stated)}), root, timeout_seconds=0.5 if stalls else PATIENCE)
    assert recorded(root)["spring"]["url"] == url
    assert visible(root) == COMPLETE
    assert len([line for line in caplog.records if line.levelno == logging.WARNING]) == 1


def test_a_person_is_told_where_to_store_the_file_if_all_addresses_fail(server: Server, root: Path) -> None:
    with pytest.raises(NotThere, match=f"/two answers 404 .*{root / 'archives' / 'spring.zip'}$"):
        get(little(parts={"spring": spring(f"{server.url}/one", f"{server.url}/two")}), root)
    assert [asked.path for asked in server.asked] == ["/one", "/two"]
    assert not (root / "spring").exists()


@contextmanager
def interrupting(title: str) -> Iterator[None]:
    """As when somebody presses Ctrl-C a third into a download."""

    def interrupt(stage: str, done: float) -> None:
        if stage.startswith("downloading") and 0.3 < done < 1:
            raise KeyboardInterrupt

    with listening(interrupt):
        yield


class TestInterruptions:
    @pytest.mark.parametrize("honours_ranges", [True, False])
    def test_an_interrupted_download_is_continued_by_the_same_command(
        self, server: Server, root: Path, monkeypatch: pytest.MonkeyPatch, honours_ranges: bool
    ) -> None:
        entry = little(parts={"spring": spring(server.serve("/spring", SPRING, honours_ranges=honours_ranges))})
        with monkeypatch.context() as patch:
            patch.setattr(command, "progress_shown", interrupting)
            with pytest.raises(KeyboardInterrupt):
                get(entry, root)
        assert not (root / "spring").exists()
        server.asked.clear()
        get(entry, root)
        assert visible(root) == COMPLETE
        assert {asked.range for asked in server.asked} - {None} == {f"bytes={CHUNK}-"}

    def test_two_fetches_do_not_share_a_folder_and_what_a_killed_one_left_is_removed(
        self, server: Server, root: Path
    ) -> None:
        entry = little(parts={"spring": spring(server.serve("/spring", SPRING))})
        (root / ".unpacking-12345678" / "spring").mkdir(parents=True)
        with FileLock(root / ".fetch.lock"), pytest.raises(BadInput, match="another fetch"):
            get(entry, root)
        assert server.asked == []
        assert get(entry, root) == 0
        assert not (root / ".unpacking-12345678").exists()


class TestArchives:
    @pytest.mark.parametrize("by_hand", [False, True])
    def test_a_damaged_one_is_deleted_or_replaced_and_the_next_fetch_is_right(
        self, server: Server, root: Path, by_hand: bool
    ) -> None:
        url = server.serve("/spring", SPRING[:-CHUNK])
        entry = little(parts={"spring": spring(url)})
        if by_hand:
            (root / "archives").mkdir(parents=True)
            (root / "archives" / "spring.zip").write_bytes(SPRING[:-CHUNK])
        else:
            with pytest.raises(BadInput, match=r"spring.zip is damaged"):
                get(entry, root)
            assert visible(root) == ["archives"]
        server.serve("/spring", SPRING)
        assert get(entry, root) == 0
        assert visible(root) == COMPLETE

    def test_a_hostile_one_changes_nothing_and_is_kept(self, server: Server, root: Path) -> None:
        hostile = tarred({"spring/1.png": b"one"}, [special("spring/2.png", b"2", "/etc/passwd")])
        with pytest.raises(BadInput, match=r"'spring/2\.png', which is a link: nothing was unpacked"):
            get(little(parts={"spring": spring(server.serve("/spring", hostile))}), root)
        assert visible(root) == ["archives", "archives/spring.zip"]

    def test_one_without_the_expected_folder_is_refused_and_another_number_of_files_is_said(
        self, server: Server, root: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        entry = little(parts={"spring": spring(server.serve("/spring", zipped({"Spring/1.png": b"one"})))})
        with pytest.raises(BadInput, match="gave no folder spring"):
            get(entry, root)
        assert visible(root) == ["archives", "archives/spring.zip"]
        shutil.rmtree(root)
        server.serve("/spring", zipped({"spring/1.png": b"one"}))
        assert get(entry, root) == 0
        assert f"{root / 'spring'}: 1 file, but 2 were expected" in capsys.readouterr().out

    def test_other_files_than_stated_are_refused(self, server: Server, root: Path) -> None:
        lines = f"{hashlib.sha256(b'one').hexdigest()}  1.png\n{hashlib.sha256(b'two').hexdigest()}  2.png\n"
        stated = {"spring": Held(sha256=hashlib.sha256(lines.encode()).hexdigest())}
        url = server.serve("/spring", zipped({"spring/2.png": b"two", "spring/1.png": b"One"}))
        part = Part("spring.zip", (url,), Wanted(unpacked_bytes=100), stated)
        with pytest.raises(BadInput, match="gave other files in spring than expected"):
            get(little(parts={"spring": part}), root)
        assert not (root / "spring").exists()
        shutil.rmtree(root)
        server.serve("/spring", zipped({"spring/2.png": b"two", "spring/1.png": b"one"}))
        assert get(little(parts={"spring": part}), root) == 0

    def test_one_put_there_by_hand_needs_no_net_and_is_compared_with_what_is_stated(
        self, root: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        monkeypatch.setenv("VPRBENCH_OFFLINE", "1")
        archive = root / "archives" / "spring.zip"
        archive.parent.mkdir(parents=True)
        entry = little(parts={"spring": spring("https://example.org/spring.zip", sha256=SHA256)})
        archive.write_bytes(SUMMER)
        with pytest.raises(BadInput, match=f"{archive} has SHA-256 .* stated is {SHA256}"):
            get(entry, root)
        archive.write_bytes(SPRING)
        assert get(entry, root) == 0
        assert visible(root) == COMPLETE
        assert recorded(root)["spring"]["url"] is None
        assert f"SHA-256 {SHA256} (as stated)" in capsys.readouterr().out


def test_nothing_is_asked_for_where_downloads_are_forbidden(
    server: Server, root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("VPRBENCH_OFFLINE", "1")
    with pytest.raises(NotThere, match=r"VPRBENCH_OFFLINE forbids downloads: get http.*/spring elsewhere and store it"):
        get(little(parts={"spring": spring(server.serve("/spring", SPRING))}), root)
    assert server.asked == []


def free(monkeypatch: pytest.MonkeyPatch, n_bytes: int) -> None:
    """Let every disk have so many bytes free."""
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: SimpleNamespace(total=10**12, used=0, free=n_bytes))


def test_a_disk_that_is_too_small_is_named_before_anything_is_asked_for(
    server: Server, root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    needed = 4 * CHUNK + 5_000_000  # what is unpacked, and what is downloaded
    entry = little(parts={"spring": spring(server.serve("/spring", SPRING), about_bytes=5_000_000)})
    free(monkeypatch, needed - 1)
    with pytest.raises(BadInput, match=r"has 7\.1 MB free, but 7\.1 MB may be needed: free some"):
        get(entry, root)
    assert server.asked == []
    assert not root.exists()
    free(monkeypatch, needed)
    assert get(entry, root) == 0


def test_what_an_interrupted_download_has_left_is_not_counted_twice(
    server: Server, root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = server.serve("/spring", SPRING)
    entry = little(parts={"spring": spring(url, size_bytes=len(SPRING))})
    with monkeypatch.context() as patch:
        patch.setattr(command, "progress_shown", interrupting)
        with pytest.raises(KeyboardInterrupt):
            get(entry, root)
    free(monkeypatch, 4 * CHUNK + len(SPRING) - CHUNK)
    assert get(entry, root) == 0


def test_an_empty_folder_on_another_disk_is_refused_before_anything_is_asked_for(
    server: Server, root: Path, tmp_path: Path
) -> None:
    (tmp_path / "disk").mkdir()
    root.mkdir(parents=True)
    (root / "spring").symlink_to(tmp_path / "disk")
    with pytest.raises(BadInput, match=f"{root / 'spring'} is a link"):
        get(little(parts={"spring": spring(server.serve("/spring", SPRING))}), root)
    assert server.asked == []


def test_folders_that_are_there_in_part_are_not_mixed_with_others(server: Server, root: Path) -> None:
    url = server.serve("/both", SPRING)
    part = Part("both.zip", (url,), Wanted(unpacked_bytes=4 * CHUNK), {"spring": Held(), "summer": Held()})
    (root / "summer").mkdir(parents=True)
    (root / "summer" / "1.png").write_bytes(b"mine")
    message = f"{root / 'summer'} is there, but not {root / 'spring'}: move it away"
    with pytest.raises(BadInput, match=message):
        get(little(parts={"both": part}), root)
    assert server.asked == []
