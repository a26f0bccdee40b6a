"""Unpacking: all of what is wanted gets into its folder or nothing does, and nothing gets anywhere else."""

import gzip
import lzma
import re
import stat
import struct
import tarfile
import tracemalloc
import zipfile

import numpy as np
import pytest
from archive_files import special, tarred, zipped
from file_limit import no_file_may_exceed

from vprbench.errors import BadInput
from vprbench.progress import listening
from vprbench.storage.unpack import DamagedArchive, Wanted, unpack

NOISE = np.random.default_rng(0).bytes(30_000)  # that no compression makes smaller
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
    around = archive.parent
    before = everything(around)
    with pytest.raises(kind, match=message) as caught:
        unpack(archive, to, wanted)
    assert "\n" not in str(caught.value)
    assert isinstance(caught.value, DamagedArchive) == (kind is DamagedArchive)
    assert everything(around) == before
    assert [path.name for path in to.iterdir()] == ["winter"]


@pytest.mark.parametrize("maker", [*MAKERS, "xz in streams"])
def test_the_wanted_files_come_out_under_their_names(archive, to, maker):
    hidden = {"__MACOSX/set/1.png": b"x", "set/spring/._1.png": b"x", "set/.hidden/3.png": b"x"}
    if maker in MAKERS:
        archive.write_bytes(MAKERS[maker]({**hidden, **FILES}))
    else:
        content = tarred(FILES, compression="")
        archive.write_bytes(lzma.compress(content[:700]) + lzma.compress(content[700:]))
    (to / "spring").mkdir()  # an empty folder is no obstacle
    heard = []
    with listening(lambda stage, done: heard.append(done)):
        assert unpack(archive, to, WANTED) == 2
    assert everything(to) == {"spring/1.png": b"one", "spring/2.png": b"two", "winter/1.png": b"mine"}
    assert sorted(path.name for path in to.iterdir()) == ["spring", "winter"]
    assert heard == sorted(heard)
    assert (heard[0], heard[-1]) == (0.0, 1.0)


def test_what_is_interrupted_does_not_get_there(archive, to):
    archive.write_bytes(zipped(FILES))

    def interrupt(stage, done):
        if done:
            raise KeyboardInterrupt

    with listening(interrupt), pytest.raises(KeyboardInterrupt):
        unpack(archive, to, WANTED)
    assert [path.name for path in to.iterdir()] == ["winter"]


@pytest.mark.parametrize("maker", ["zip", "tar"])
@pytest.mark.parametrize("name", ["../1.png", "/tmp/1.png", "set/C:1.png", "set\\1.png", "../x.me", "a/\x1b[2J.png"])
def test_a_path_that_leads_out_is_refused_wanted_or_not(archive, to, name, maker):
    archive.write_bytes(MAKERS[maker]({**FILES, name: b"x"}))
    refused(archive, to, WANTED, re.escape(ascii(name)))


@pytest.mark.parametrize("kind", [tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.FIFOTYPE])
def test_a_tar_with_more_than_files_is_refused_and_nothing_written_through_a_link(archive, to, tmp_path, kind):
    archive.write_bytes(tarred(FILES, [special("set/spring/3.png", kind, "/etc/passwd")]))
    refused(archive, to, WANTED, "'set/spring/3.png', which is no plain file")
    link = special("set/spring", tarfile.SYMTYPE, str(tmp_path)).tobuf()
    archive.write_bytes(link + tarred({"set/spring/1.png": b"one"}, compression=""))
    unpack(archive, to, WANTED)  # the link is no *.png, and left out
    assert not (to / "spring").is_symlink()
    assert not (tmp_path / "1.png").exists()


@pytest.mark.parametrize(
    ("mode", "compression", "said"),
    [
        (stat.S_IFLNK, zipfile.ZIP_DEFLATED, "no plain file"),
        (stat.S_IFCHR, zipfile.ZIP_DEFLATED, "no plain file"),
        (stat.S_IFREG, zipfile.ZIP_BZIP2, "fill the memory"),  # a compression that knows no bound
    ],
)
def test_a_zip_with_more_than_files_is_refused(archive, to, mode, compression, said):
    info = zipfile.ZipInfo("set/spring/3.png")
    info.external_attr, info.compress_type = (mode | 0o777) << 16, compression
    with zipfile.ZipFile(archive, "w") as made:
        made.writestr(info, bytes(10_000))
    refused(archive, to, WANTED, said)


@pytest.mark.parametrize("maker", ["zip", "gz"])
def test_no_more_bytes_and_files_come_out_than_expected(archive, to, maker):
    archive.write_bytes(MAKERS[maker]({"set/spring/1.png": bytes(600), "set/spring/2.png": bytes(401)}))
    refused(archive, to, Wanted(unpacked_bytes=1000), "more than 1000 bytes")
    refused(archive, to, Wanted(unpacked_bytes=2000, only="*.jpg", most_files=1), "more than 1 files")
    assert unpack(archive, to, Wanted(unpacked_bytes=1001, most_files=2)) == 2


def test_a_zip_that_states_fewer_bytes_than_it_holds_is_damaged(archive, to):
    content = bytearray(zipped({"set/spring/1.png": bytes(1_000_000)}))
    for signature, offset in ((b"PK\x03\x04", 22), (b"PK\x01\x02", 24)):  # beside the file, and in the list
        struct.pack_into("<I", content, content.index(signature) + offset, 10)
    archive.write_bytes(content)
    refused(archive, to, Wanted(unpacked_bytes=100), "is damaged, or no archive", DamagedArchive)


def empty(name, **fields):
    info = tarfile.TarInfo(name)
    for field, value in fields.items():
        setattr(info, field, value)
    return info.tobuf(tarfile.PAX_FORMAT)


LONG_NAME = empty("long", type=tarfile.GNUTYPE_LONGNAME, size=1 << 32) + bytes(20_000_000)
OLD_SPARSE = bytearray(empty("set/1.png", type=tarfile.GNUTYPE_SPARSE))
OLD_SPARSE[482] = 1  # more of its map follows
OLD_SPARSE[148:156] = b"%06o\0 " % tarfile.calc_chksums(OLD_SPARSE)[0]
OLD_SPARSE += (b"00000000001\0" * 42 + b"\1" + bytes(7)) * 40_000
SPARSE = {"GNU.sparse.major": "1", "GNU.sparse.minor": "0"}


@pytest.mark.parametrize(
    "content",
    [
        LONG_NAME,
        OLD_SPARSE,
        empty("set/1.png", size=1 << 40, pax_headers=SPARSE) + b"1000000000\n" + b"1234567890123456\n" * 1_000_000,
    ],
)
def test_an_archive_whose_header_asks_for_the_whole_memory_is_refused(archive, to, content):
    archive.write_bytes(gzip.compress(content, 1))
    tracemalloc.start()
    refused(archive, to, WANTED, "takes more than", DamagedArchive)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 12_000_000
    greedy = [{"id": lzma.FILTER_LZMA2, "preset": 0, "dict_size": 1 << 30}]
    archive.write_bytes(lzma.compress(b"tar", filters=greedy))
    refused(archive, to, WANTED, "Memory usage limit", DamagedArchive)


@pytest.mark.parametrize(
    ("files", "wanted", "said"),
    [
        ({"set/autumn/1.png": b"one", "set/winter/2.png": b"two"}, WANTED, "winter is there"),  # is never replaced
        ({"set/1.png": b"one", "set/./1.png": b"two"}, WANTED, "1.png twice"),
        ({"a/1.png": b"one", "b/1.png": b"two"}, Wanted(unpacked_bytes=9, strip="all"), "1.png twice"),
        ({"set/a.png": b"one", "set/a.png/1.png": b"two"}, WANTED, "twice"),  # a file that is a folder too
        ({"set/1.jpg": b"one"}, WANTED, r"no file like \*\.png"),
        ({"1.png": b"one"}, WANTED, "'1.png', expected in 1 folders"),
    ],
)
def test_other_files_than_expected_are_refused(archive, to, files, wanted, said):
    archive.write_bytes(tarred(files))
    refused(archive, to, wanted, said)


def with_another(content, position):
    return content[:position] + bytes([content[position] ^ 0xFF]) + content[position + 1 :]


WHOLE = {name: make({"set/spring/1.png": NOISE, "set/spring/2.png": NOISE[::-1]}) for name, make in MAKERS.items()}
DAMAGED = {
    # of a plain tar the zeros at its end alone may be missing
    **{
        f"{name}, {n} %": whole[: n * len(whole.rstrip(b"\0")) // 100] for name, whole in WHOLE.items() for n in (2, 98)
    },
    **{f"{name}, other": with_another(whole, len(whole) // 2) for name, whole in WHOLE.items() if name != "tar"},
    "nothing": b"",
    "a web page": b"<!doctype html>",
    "no gz": b"\x1f\x8bno",
    "no zip": b"PK\x03\x04no",
}


@pytest.mark.parametrize("content", DAMAGED.values(), ids=DAMAGED)
def test_an_archive_that_ends_early_has_a_changed_byte_or_is_none_is_damaged(archive, to, content):
    archive.write_bytes(content)
    refused(archive, to, WANTED, "damaged|ends early", DamagedArchive)


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
