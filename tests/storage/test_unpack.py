"""Unpacking: all of the wanted files get into their folder or none does, and nothing gets anywhere else."""

import re
import stat
import struct
import tarfile
import zipfile

import numpy as np
import pytest
from archive_files import special, tarred, zipped
from file_limit import no_file_may_exceed

from vprbench.errors import BadInput
from vprbench.progress import send_reports_to
from vprbench.storage.unpack import DamagedArchive, Wanted, unpack

NOISE = np.random.default_rng(0).bytes(30_000)  # no compression makes it smaller
FILES = {"set/spring/1.png": b"one", "set/spring/2.png": b"two", "set/read.me": NOISE}
WANTED = Wanted(unpacked_bytes=10**6, only="*.png", strip=1)
MAKERS = {
    "zip": zipped,
    "tar": lambda files: tarred(files, compression=""),
    "gz": tarred,
    "bz2": lambda files: tarred(files, compression="bz2"),
    "xz": lambda files: tarred(files, compression="xz"),
}


@pytest.fixture
def archive(tmp_path):
    return tmp_path / "frames.tar.gz"  # whatever it holds


@pytest.fixture
def to(tmp_path):
    """The destination, with somebody's file in it."""
    (tmp_path / "data" / "winter").mkdir(parents=True)
    (tmp_path / "data" / "winter" / "1.png").write_bytes(b"mine")
    return tmp_path / "data"


def everything(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def refused(archive, to, wanted, message, kind=BadInput):
    """Unpacking raises, and nothing has changed on the disk, in the destination or around it."""
    before = everything(archive.parent)
    with pytest.raises(BadInput, match=message) as caught:
        unpack(archive, to, wanted)
    assert "\n" not in str(caught.value)
    assert type(caught.value) is kind
    assert everything(archive.parent) == before
    assert [path.name for path in to.iterdir()] == ["winter"]  # no empty folder is left


@pytest.mark.parametrize("maker", MAKERS)
def test_the_wanted_files_come_out_under_their_names(archive, to, maker):
    hidden = {"__MACOSX/set/1.png": b"x", "set/spring/._1.png": b"x", "set/.hidden/3.png": b"x"}
    archive.write_bytes(MAKERS[maker]({**hidden, **FILES}))
    (to / "spring").mkdir()  # an empty folder is no obstacle
    heard = []
    with send_reports_to(lambda stage, done: heard.append((stage, done))):
        assert unpack(archive, to, WANTED) == 2
    assert everything(to) == {"spring/1.png": b"one", "spring/2.png": b"two", "winter/1.png": b"mine"}
    assert sorted(path.name for path in to.iterdir()) == ["spring", "winter"]
    assert heard == [("unpacking frames.tar.gz", share) for share in (3e-6, 6e-6)]


@pytest.mark.parametrize("maker", ["zip", "tar"])
@pytest.mark.parametrize("name", ["../1.png", "/tmp/1.png", "set/../../1.png", "../x.me"])
def test_a_path_that_leads_out_is_refused_wanted_or_not(archive, to, name, maker):
    archive.write_bytes(MAKERS[maker]({**FILES, name: b"x"}))
    refused(archive, to, WANTED, re.escape(ascii(name)))


@pytest.mark.parametrize("kind", [tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.FIFOTYPE, stat.S_IFLNK, stat.S_IFCHR])
def test_links_and_devices_are_refused_and_nothing_is_written_through_a_link(archive, to, tmp_path, kind):
    if isinstance(kind, bytes):
        archive.write_bytes(tarred(FILES, [special("set/spring/3.png", kind, "/etc/passwd")]))
    else:
        info = zipfile.ZipInfo("set/spring/3.png")
        info.external_attr = (kind | 0o777) << 16
        with zipfile.ZipFile(archive, "w") as made:
            made.writestr(info, "/etc/passwd")
    refused(archive, to, WANTED, "'set/spring/3.png', which is no plain file")
    link = special("set/spring", tarfile.SYMTYPE, str(tmp_path)).tobuf()
    archive.write_bytes(link + tarred({"set/spring/1.png": b"one"}, compression=""))
    unpack(archive, to, WANTED)  # the link is no *.png, and left out
    assert not (to / "spring").is_symlink()
    assert not (tmp_path / "1.png").exists()


@pytest.mark.parametrize("maker", ["zip", "gz"])
def test_no_more_bytes_and_files_come_out_than_expected(archive, to, maker):
    archive.write_bytes(MAKERS[maker]({"set/spring/1.png": bytes(600), "set/spring/2.png": bytes(401)}))
    refused(archive, to, Wanted(unpacked_bytes=1000), "more than .* 1000 bytes")
    refused(archive, to, Wanted(unpacked_bytes=2000, only="*.jpg", most_files=1), "more than 1 files")
    assert unpack(archive, to, Wanted(unpacked_bytes=1001, most_files=2)) == 2


def test_a_zip_that_states_fewer_bytes_than_it_holds_is_damaged(archive, to):
    content = bytearray(zipped({"set/spring/1.png": bytes(1_000_000)}))
    for signature, offset in ((b"PK\x03\x04", 22), (b"PK\x01\x02", 24)):  # beside the file, and in the list
        struct.pack_into("<I", content, content.index(signature) + offset, 10)
    archive.write_bytes(content)
    refused(archive, to, Wanted(unpacked_bytes=100), "is damaged, or no archive", DamagedArchive)


def test_other_files_than_expected_are_refused(archive, to):
    for files, wanted, message in (
        ({"set/autumn/1.png": b"one", "set/winter/2.png": b"two"}, WANTED, "winter is there"),  # is never replaced
        ({"set/1.png": b"one", "set/./1.png": b"two"}, WANTED, "1.png twice"),
        ({"a/1.png": b"one", "b/1.png": b"two"}, Wanted(unpacked_bytes=9, strip="all"), "1.png twice"),
        ({"set/a.png": b"one", "set/a.png/1.png": b"two"}, WANTED, "twice"),  # a file that is a folder too
        ({"set/1.jpg": b"one"}, WANTED, r"no file like \*\.png"),
    ):
        archive.write_bytes(tarred(files))
        refused(archive, to, wanted, message)


def damage(whole, name):
    """Cut an archive at its start and its end, and change a byte; in a plain tar, which has no checksum, none."""
    length, half = len(whole.rstrip(b"\0")), len(whole) // 2
    changed = whole[:half] + bytes([whole[half] ^ 0xFF]) + whole[half + 1 :]
    return [whole[: length // 50], whole[: length * 49 // 50], *([] if name == "tar" else [changed])]


@pytest.mark.parametrize("name", [*MAKERS, "none"])
def test_an_archive_that_ends_early_has_a_changed_byte_or_is_none_is_damaged(archive, to, name):
    contents = [b"", b"<!doctype html>", b"\x1f\x8bno", b"PK\x03\x04no"]
    if name != "none":
        contents = damage(MAKERS[name]({"set/spring/1.png": NOISE, "set/spring/2.png": NOISE[::-1]}), name)
    for content in contents:
        archive.write_bytes(content)
        refused(archive, to, WANTED, "is damaged", DamagedArchive)


def test_folders_can_be_left_out_and_a_full_disk_leaves_nothing(archive, to, tmp_path):
    archive.write_bytes(zipped({"set/a/1.png": bytes(50_000), "set/b/1.png": b"two"}))
    with no_file_may_exceed(20_000):
        refused(archive, to, WANTED, r"\(.*File.*large\).*: free")
    archive.write_bytes(zipped({"a/b/1.png": b"one", "2.png": b"two"}))
    to = tmp_path / "new" / "data"  # is made
    unpack(archive, to, Wanted(unpacked_bytes=100, strip="all", into="fall"))
    unpack(archive, to, Wanted(unpacked_bytes=1000, plain=True, into="whole"))
    plain = {"whole/frames.tar.gz": archive.read_bytes()}
    assert everything(to) == {"fall/1.png": b"one", "fall/2.png": b"two", **plain}
