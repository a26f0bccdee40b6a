"""The entries of conf/fetch: complete, honest about where files come from, and fitting what they describe."""

from pathlib import Path

import pytest
from archive_files import zipped
from checkout import SHARED

from vprbench.data.fetch.entries import downloads, read
from vprbench.data.fetch.received import content_sha256, count_files
from vprbench.errors import BadInput
from vprbench.plugins import registry
from vprbench.storage.unpack import unpack

KNOWN = downloads()
DATA = SHARED / "data"
LENS = "LENS-f44a08c/lens/dataset"


@pytest.mark.parametrize("entry", KNOWN.values(), ids=KNOWN)
def test_an_entry_says_what_a_person_has_to_know_and_its_parts_are_apart(entry):
    assert entry.description
    assert entry.licence
    assert entry.source.startswith("https://")
    assert set(entry.datasets) <= set(registry.entries("dataset"))
    parts = entry.parts.values()
    for part in parts:
        assert part.urls
        assert all(url.startswith("https://") for url in part.urls)
        assert part.file == Path(part.file).name
        assert part.holds
        assert part.sha256 is None or len(part.sha256) == 64
        assert part.about_bytes is None or part.size_bytes is None
    for names in ([part.file for part in parts], [folder for part in parts for folder in part.holds]):
        assert len({*names}) == len(names)
        assert not {"archives", "fetched.json"} & {Path(name).parts[0] for name in names}


@pytest.mark.parametrize(
    ("where", "folder", "inside", "outside"),
    [
        ("nordland spring", "", "spring/images-00001.png", "spring/read.me"),
        ("nordland spring", "", "images-00001.png", "read.me"),
        ("nordland_64x32 frames", "seqslam-38311ac/datasets/", "nordland_trimmed/summer/1.png", "other/1.png"),
        ("corridor frames", "VPR-Bench-77ad30f/datasets/", "corridor/query/0.jpg", "17places/query/0.jpg"),
        (
            "oxford_robotcar lists",
            "VPRSNN-d38f30c/dataset_imagenames/",
            "ORC_Sun_timestamps.csv",
            "ORC_imageNames_Sun.txt",
        ),
        ("pitts30k lists", "datasets/", "pitts30k_test.mat", "read.me"),
        ("gardens_point frames", "day_left/", "Image000.jpg", "Thumbs.db"),
        (
            "brisbane_events_7x7 frames",
            f"{LENS}/brisevent/davis346/",
            "sunset1/images_00000.png",
            "night/images_00000.png",
        ),
    ],
)
def test_a_part_takes_its_files_out_of_an_archive(tmp_path, where, folder, inside, outside):
    name, part = where.split()
    wanted, holds = KNOWN[name].parts[part].unpack, KNOWN[name].parts[part].holds
    (tmp_path / "archive.zip").write_bytes(zipped({folder + inside: b"frame", folder + outside: b"other"}))
    assert unpack(tmp_path / "archive.zip", tmp_path / "to", wanted) == 1
    there = next(tmp_path / "to" / held for held in holds if (tmp_path / "to" / held).exists())
    assert (there / Path(inside).name).read_bytes() == b"frame"


@pytest.mark.real_frames
@pytest.mark.parametrize("folder", ["nordland_64x32/winter", "corridor/ref", "brisbane_events_7x7/sunset1"])
def test_the_stated_hash_is_that_of_the_frames(folder):
    name, _, part = folder.partition("/")
    held = KNOWN[name].parts["frames"].holds[part]
    assert (count_files(DATA / folder), content_sha256(DATA / folder)) == (held.files, held.sha256)


HEAD = "# A little journey\nlicence: CC BY 4.0\nsource: https://example.org\ndatasets: []\n"
PART = """\
parts:
  all: {file: all.zip, urls: ["https://example.org/all.zip"], unpack: {unpacked_bytes: 9}, holds: {spring: {}}}
"""


def test_an_entry_is_named_and_described_by_its_file(tmp_path):
    (tmp_path / "little.yaml").write_text(HEAD + PART)
    entry = read(tmp_path / "little.yaml")
    assert (entry.name, entry.folder, entry.description) == ("little", "little", "A little journey")
    assert entry.parts["all"].unpack.strip == 0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEAD, "little.yaml has neither parts nor register"),
        (HEAD + PART + "seasons: 4\n", "little.yaml=.*nexpected"),
        (HEAD + PART.replace("holds: {spring: {}}", "hold: 1"), "little.yaml=.*"),
        (HEAD + PART + "default: [some]\n", "default names some, which is none of its parts"),
        (HEAD.replace("licence", "license") + PART, "little.yaml=.*"),
        ("- a list\n", "little.yaml holds no entry"),
        ("a: [\n", "little.yaml is no yaml"),
    ],
)
def test_a_broken_entry_is_named_in_one_line(tmp_path, text, message):
    (tmp_path / "little.yaml").write_text(text)
    with pytest.raises(BadInput, match=message) as caught:
        read(tmp_path / "little.yaml")
    assert "\n" not in str(caught.value)
