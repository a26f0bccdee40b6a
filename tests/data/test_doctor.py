"""What the doctor finds in folders, frames, lists and recordings; docs/doctor.md shows its words."""

import json
import re
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
from checkout import ROOT
from little import picture
from PIL import Image as PillowImage

from vprbench.api.dataset import Dataset, FrameFolder
from vprbench.api.events import Events, Recording
from vprbench.api.images import Images
from vprbench.data.doctor import as_text, check_dataset, command, examine, look_at_some, quick
from vprbench.errors import BadInput, MissingData

PLACES = 60
NAMES = [f"{place:03d}.png" for place in range(PLACES)]

_STEP = 24  # pixels from place to place; a frame is 64 wide
_NUMBER = re.compile(r"\d+x\d+|\d[\d,.]*(?<![,.])")


def season(number, places=PLACES):
    """Return frames of a ride past a made-up landscape; each season has its own light and noise, all are aligned."""
    width = _STEP * places + 64
    rough = np.random.default_rng(0).random((6, width // 10), np.float32)
    land = cv2.resize(rough, (width, 32), interpolation=cv2.INTER_CUBIC)
    weather = np.random.default_rng(1 + number)
    light = land * (150 - 20 * number) + 40 + 10 * number
    seen = np.clip(light + weather.normal(0, 15, light.shape), 30, 255).astype(np.uint8)
    frames = [seen[:, _STEP * place : _STEP * place + 64] for place in range(places)]
    return [np.repeat(frame[:, :, None], 3, axis=2) for frame in frames]


def save(folder, frames, names=None):
    """Write frames as PNG files; they are named by their number where no names come."""
    folder.mkdir(parents=True)
    for number, frame in enumerate(frames):
        PillowImage.fromarray(frame).save(folder / (names[number] if names else f"{number:03d}.png"))
    return folder


@pytest.fixture
def healthy(tmp_path):
    """The folders of a winter and a summer of the same places."""
    return save(tmp_path / "winter", season(0)), save(tmp_path / "summer", season(1))


def dataset_of(references, queries, names=NAMES, query_names=None, right=None, protocol=None, **counts):
    """Return the dataset of two folders; the i-th query shows the i-th place unless `right` says otherwise."""
    asked = names if query_names is None else query_names
    known = {"references": [references.name], "query": queries.name, "tolerance_places": 0}
    return Dataset(
        name="little",
        references=Images.from_files([references / name for name in names]),
        places=np.arange(len(names)),
        queries=Images.from_files([queries / name for name in asked]),
        positives=tuple(np.array(places, np.int64) for places in right or [[i] for i in range(len(asked))]),
        protocol={**known, **(protocol or {})},
        folders=tuple(FrameFolder(at, tuple(used), **counts) for at, used in ((references, names), (queries, asked))),
    )


def coded(found, folder):
    """Return level, check, numbers and numbered names of every finding, without the path of the tests' `folder`."""
    return [
        f"{one.level} {one.check}: {' '.join(re.findall(_NUMBER, one.text.replace(str(folder), '')))}".rstrip()
        for one in found
    ]


PAGE = b"<!DOCTYPE html><html><body>Sign in to download</body></html>"
DOCUMENT = (ROOT / "docs" / "doctor.md").read_text(encoding="utf-8")
SHOWN = dict(re.findall(r"^## ([^\n]*)\n\n```\n(.*?)```", DOCUMENT, re.MULTILINE | re.DOTALL))
PLAIN = [f"{number}.png" for number in range(12)]
UNNAMED = [f"{place}.png" for place in range(PLACES)]  # 1, 10, 2 in a dictionary
OLID = "the partition of Olid et al., which numbers the frames in another way"


@pytest.fixture
def spoilt(healthy):
    """A function that returns the dataset of two healthy folders after some damage."""

    def spoilt(damage):
        besides = damage(*healthy)
        return dataset_of(*healthy, **(besides if isinstance(besides, dict) else {}))

    return spoilt


def again(folder, frames, names=None):
    shutil.rmtree(folder)
    save(folder, frames, names)


def change(folder, names, how, **options):
    """Store what becomes of the pixels of frames."""
    for name in names:
        pixels = how(np.asarray(PillowImage.open(folder / name)))
        PillowImage.fromarray(pixels.astype(np.uint8)).save(folder / name, **options)


def tag(folder, names):
    """Store frames upside down, with the EXIF tag that turns them back, in a dataset that ignores it."""
    exif = PillowImage.Exif()
    exif[0x0112] = 3
    change(folder, names, lambda pixels: pixels[::-1, ::-1], exif=exif)
    return {"protocol": {"exif": "ignore"}}


def write(folder, names, how):
    for name in names:
        (folder / name).write_bytes(how((folder / name).read_bytes()))


def of_frames(winter, summer, references, queries, names=None):
    """Store other frames; `names` are those of the places, and the queries come in the order of a dictionary."""
    again(winter, references, names)
    again(summer, queries, names)
    return {"names": names, "query_names": sorted(names)} if names else {}


LONGER = season(1, PLACES + 1)


DOCUMENTED = {
    "Missing files": lambda winter, summer: [(winter / name).unlink() for name in NAMES[10:17]],
    "Empty file": lambda _, summer: write(summer, NAMES[5:6], lambda _: b""),
    "Web page as .png": lambda _, summer: write(summer, NAMES[31:32], lambda _: PAGE),
    "Truncated": lambda _, summer: write(summer, NAMES[3:10], lambda whole: whole[:900]),
    "Other size": lambda winter, summer: change(summer, NAMES[40:42], lambda pixels: pixels[::2, ::2]),
    "Another partition": lambda *_: {"counts": (70,), "wrong_counts": {PLACES: OLID}},
    "Repeated frame": lambda winter, summer: shutil.copy(summer / "011.png", summer / "012.png"),
    "Black frames": lambda winter, summer: change(summer, NAMES[20:23], np.zeros_like),
    "Few levels": lambda winter, summer: change(summer, NAMES[7:9], lambda p: p // 16 * 16),
    "Tags that are ignored": lambda winter, summer: tag(summer, NAMES[50:]),
    "Shifted by 3": lambda winter, summer: again(summer, [*season(1)[3:], *season(1, PLACES + 3)[PLACES:]]),
    "A frame too few": lambda *both: of_frames(*both, season(0, PLACES + 1)[:PLACES], LONGER[:35] + LONGER[36:]),
    "Reversed": lambda winter, summer: again(summer, season(1)[::-1]),
    "Wrong season folder": lambda winter, summer: again(summer, season(0)),
    "Queries in the map": lambda winter, summer: shutil.copy(winter / "044.png", summer / "044.png"),
    "Lexicographic order": lambda *both: of_frames(*both, season(0), season(1), UNNAMED),
    "Query without right place": lambda *_: {"right": [[] if place in (4, 9) else [place] for place in range(PLACES)]},
}


@pytest.mark.parametrize("title", [*SHOWN, *sorted({*DOCUMENTED} - {*SHOWN})])
def test_the_document_shows_what_the_doctor_says(title, tmp_path, spoilt):
    said = []
    assert command("little", lambda: spoilt(DOCUMENTED[title]), said.append) == 1
    paragraphs = said[0].replace(str(tmp_path), "/data").split("\n\n")[1:]
    told = [" ".join(paragraph.split()) for paragraph in paragraphs]
    shown = [line for line in told if not line.startswith("note alignment: summer and winter are aligned")]
    assert " ".join(shown) == " ".join(SHOWN[title].split())


def copied(winter, summer):
    shutil.copy(summer / "011.png", summer / "012.png")
    PillowImage.open(summer / "030.png").save(summer / "031.png", compress_level=0)  # other bytes, the same pixels
    shutil.copy(winter / "044.png", summer / "044.png")


LFS = b"version https://git-lfs.github.com/spec/v1"
EXAMINED = {
    "a page as large as an image": (
        lambda winter, _: write(winter, ["017.png"], lambda whole: b"Service unavailable. ".ljust(len(whole))),
        ["error decoding: 1 60 017"],
    ),
    "a Git LFS pointer": (lambda winter, _: write(winter, ["031.png"], lambda _: LFS), ["error decoding: 1 60 031"]),
    "no frame of a traverse": (
        lambda winter, _: write(winter, NAMES, lambda _: b"nothing"),
        ["error decoding: 60 60 000 001 002 003 004 55"],
    ),
    "two sizes in one traverse": (
        lambda _, summer: change(summer, NAMES[:20], lambda p: p.repeat(2, 0).repeat(2, 1)),
        ["note size: 20 64x32 40 000 001 002 003 004 15"],
    ),
    "frames of one grey value": (
        lambda _, summer: change(summer, NAMES[20:23], lambda p: 0 * p + 200),
        ["warning black frames: 3 60 3 255 020 021 022"],
    ),
    "frames that are the same": (
        copied,
        ["error shared frames: 1 60 044 044", "warning repeated frames: 2 011 012 030 031"],
    ),
}


@pytest.mark.parametrize("damage", EXAMINED)
def test_the_look_at_every_frame_finds(damage, tmp_path, spoilt):
    spoil, expected = EXAMINED[damage]
    *found, compared = sorted(coded(examine(spoilt(spoil)), tmp_path), key=lambda code: code.startswith("note align"))
    assert found == expected
    assert (compared == "note alignment: 0 20") == (damage == "no frame of a traverse")  # frames to compare, and needed


def test_a_run_is_refused_with_one_line_for_the_first_error_and_given_warnings_but_no_notes(tmp_path, spoilt):
    lines = check_dataset(spoilt(lambda *_: {"counts": (55,)}))
    assert lines == tuple(f"{tmp_path / one} holds 60 images; a whole copy has 55" for one in ("winter", "summer"))
    for folder in ("winter", "summer"):
        write(tmp_path / folder, ["000.png"], lambda _: b"")
    with pytest.raises(BadInput) as refused:
        check_dataset(dataset_of(tmp_path / "winter", tmp_path / "summer"))
    line = str(refused.value)
    assert line.startswith(f"dataset little: 1 file of {tmp_path / 'winter'} is empty (0 bytes): 000.png: ")
    assert line.endswith("(1 more, which the doctor names)")


def test_sound_frames_exit_with_0_and_a_dataset_that_cannot_be_built_with_1(spoilt):
    def nothing():
        raise MissingData("winter/000.png is missing: get the frames")

    for build, code, said in ((lambda: spoilt(lambda *_: {}), 0, "note alignment"), (nothing, 1, "error dataset")):
        lines = []
        assert command("little", build, lines.append, "json") == code
        (finding,) = json.loads(lines[0])
        assert f"{finding['level']} {finding['check']}" == said
        assert {*finding} == {"level", "check", "text", "advice"}
    assert as_text("little", []).endswith("nothing is wrong: 0 errors, 0 warnings, 0 notes")


@pytest.mark.parametrize(
    ("spoil", "counts"),
    [
        (lambda *_: None, []),
        (
            lambda winter, summer: (
                change(winter, NAMES[:4], np.zeros_like),
                change(summer, NAMES[8:9], lambda p: 0 * p + 200),
            ),
            ["4 60", "1 60"],
        ),
        (DOCUMENTED["Truncated"], ["7 60"]),
    ],
)
def test_a_look_at_some_frames_counts_those_that_show_nothing_or_cannot_be_read(spoil, counts, spoilt):
    assert [" ".join(re.findall(r"\d+", line)) for line in look_at_some(spoilt(spoil))] == counts


def ride(references, queries, right, names=None, query_names=None, **protocol):
    """Return a dataset of one or two reference traverses and, for each query, the places that are right."""
    return Dataset(
        name="ride",
        references=Images.from_arrays([frame for frames in references for frame in frames], names),
        places=np.tile(np.arange(len(references[0])), len(references)),
        queries=Images.from_arrays(queries, query_names),
        positives=tuple(np.array(places, np.int64) for places in right),
        protocol={"references": ["spring", "fall"][: len(references)], "query": "summer", **protocol},
    )


def checked(names=NAMES, query_names=NAMES, right=None, more=(), **protocol):
    """Return what the cheap checks find where places, queries and further reference traverses have these names."""
    listed = [*names, *(name for others in more for name in others)]
    references, queries = [[picture(0)] * len(names)] * (1 + len(more)), [picture(1)] * len(query_names)
    return quick(ride(references, queries, right or places(len(query_names)), listed, query_names, **protocol))


def places(count, skipped=()):
    """Return the place of its own for each query, none for some."""
    return [[] if query in skipped else [query] for query in range(count)]


FINDINGS = {
    "all in dictionary order": ({"names": sorted(PLAIN), "query_names": sorted(PLAIN)}, ["warning order: 10 11 2"]),
    "a file missing in the midst": (
        {"names": [name for name in NAMES if name != "020.png"], "query_names": NAMES[:59]},
        ["warning names: 38 59 021 022"],
    ),
    "references that begin at another file": ({"more": [[*NAMES[1:], NAMES[0]]]}, ["warning names: 60 60 001 000"]),
    "queries of every other place": ({"query_names": NAMES[:20], "right": [[2 * query] for query in range(20)]}, []),
    "names of another scheme": ({"query_names": [f"frame{number:03d}.png" for number in range(PLACES)]}, []),
    "a query without a right place, asked for": (
        {"right": places(PLACES, (4,)), "unmatched": "keep"},
        ["note ground truth: 1 60 1 98.3 004"],
    ),
    "no right place at all": ({"right": [[]] * PLACES}, ["error ground truth: 60 60 1 0.0 000 001 002 003 004 55"]),
    "most places right": ({"right": [range(45)] * PLACES}, ["warning ground truth: 75.0 60"]),
}


@pytest.mark.parametrize("lists", FINDINGS)
def test_the_cheap_checks_find_in_lists(lists, tmp_path):
    given, expected = FINDINGS[lists]
    assert coded(checked(**given), tmp_path) == expected


@pytest.mark.parametrize("names", [PLAIN, [f"{number:02d}.png" for number in range(12)], list("gadbhecf"), PLAIN[::-1]])
def test_other_orders_are_not_taken_for_dictionary_order(names):
    assert not [finding for finding in checked(names=names, query_names=names) if finding.check == "order"]


def compared(references, queries, right=None, tolerance=0):
    """Return what alignment says where query i shows place i, give or take the tolerance, or `right` if given."""
    n = len(references[0])
    around = [range(max(0, i - tolerance), min(n, i + tolerance + 1)) for i in range(len(queries))]
    return [finding for finding in examine(ride(references, queries, right or around)) if finding.check == "alignment"]


def noise(seed):
    return [*np.random.default_rng(seed).integers(0, 256, (PLACES, 32, 64, 3), np.uint8)]


@pytest.mark.parametrize(
    ("references", "queries", "tolerance", "told"),
    [
        (season(0), season(1), 0, "note .* are aligned: 60 of 60 queries"),
        *((season(0), noise(seed), 20 * (seed > 5), "note .*too different") for seed in (5, 8, 9, 10)),
        *(
            (season(0, 120)[first:95], season(1, 120)[: 95 - first], 0, f"error .*{told} earlier, by")
            for first, told in ((3, "3 places"), (25, "25 places"))
        ),
        *(
            (season(0, 120)[: 95 - first], season(1, 120)[first:95], 0, f"error .*{told} later, by")
            for first, told in ((1, "1 place"), (3, "3 places"))
        ),
        (season(0)[:58], season(1)[2:], 2, "note .*2 places later"),  # which the ground truth counts as right
    ],
)
def test_traverses_are_aligned_shifted_or_too_different_to_tell(references, queries, tolerance, told):
    (found,) = compared([references], queries, tolerance=tolerance)
    assert re.match(told, f"{found.level} {found.text}")


def test_a_part_that_is_shifted_is_named_with_its_ends_and_places_may_be_skipped_but_not_shuffled():
    references, queries = season(0, 400), season(1, 400)
    queries[100:130] = season(1, 400)[105:135]
    (found,) = compared([references], queries)
    assert found.level == "warning"
    assert "about image 100 to image 129 (30 of 400 queries) show what it shows 5 places later" in found.text
    right = [[place] for place in range(0, 300, 5)]
    (aligned,) = compared([season(0, 300)], season(1, 300)[::5], right)
    (shifted,) = compared([season(0, 300)], season(1, 300)[3::5], right)
    assert "are aligned" in aligned.text
    assert "3 places later" in shifted.text
    order = np.random.default_rng(0).permutation(PLACES)
    (unordered,) = compared([season(0)], [season(1)[place] for place in order], [[int(place)] for place in order])
    assert (unordered.level, unordered.text.startswith("not checked: ")) == ("note", True)


HEIGHT, WIDTH = 24, 32
SECOND = 1_000_000


def drive(seed):
    """Return the events of 60 seconds."""
    chance = np.random.default_rng(seed)
    t = np.sort(chance.integers(PLACES * SECOND, size=20_000))
    x, y = chance.integers(WIDTH, size=len(t)), chance.integers(HEIGHT, size=len(t))
    return Events(t, x.astype(np.uint16), y.astype(np.uint16), chance.random(len(t)) < 0.5)


def recorded(events, name="winter", unit=1, **changes):
    """Return a recording that comes in chunks, with a position each second."""
    metres = np.stack([10.0 * np.arange(PLACES), np.zeros(PLACES)], axis=1)
    middle = SECOND * np.arange(PLACES) + SECOND // 2

    def chunks():
        yield from (chosen(events, part) for part in np.array_split(np.arange(len(events.t)), 7))

    return replace(Recording(name, chunks, HEIGHT, WIDTH, middle // unit, metres, middle), **changes)


def chosen(events, which):
    return Events(events.t[which], events.x[which], events.y[which], events.p[which])


def swapped(events, back_us):
    t = events.t.copy()
    t[1000] = t[999] - back_us
    return recorded(replace(events, t=t))


def hot(events):
    often = np.arange(len(events.t)) % 10 == 0
    x, y = (np.where(often, at, column).astype(np.uint16) for at, column in ((7, events.x), (5, events.y)))
    return recorded(replace(events, x=x, y=y))


FOUND = {
    "nothing": (recorded, []),
    "time that runs backwards": (lambda events: swapped(events, 70_000), ["error time: 1 70,000"]),
    "a late packet": (lambda events: swapped(events, 7_000), ["note time: 1 7,000"]),
    "a gap": (lambda e: recorded(chosen(e, (e.t < 20 * SECOND) | (e.t > 22 * SECOND))), ["warning gaps: 1 2.0"]),
    "a hot pixel": (hot, ["warning hot pixels: 1 10."]),
    "polarity that is always the same": (
        lambda events: recorded(replace(events, p=np.ones_like(events.p))),
        ["warning polarity: 100.0 2"],
    ),
    "positions of another unit": (lambda events: recorded(events, unit=1000), ["error clocks: 0.0 0.1 0.0 60.0 0"]),
    "positions that are not in order": (
        lambda events: recorded(events, positions_us=np.zeros(PLACES, np.int64)),
        ["error clocks:"],
    ),
}


@pytest.mark.parametrize("damage", FOUND)
def test_the_doctor_finds_in_a_recording(damage, healthy, tmp_path):
    spoil, expected = FOUND[damage]
    recordings = spoil(drive(1)), recorded(drive(2), "summer")
    found = coded(examine(replace(dataset_of(*healthy), recordings=recordings)), tmp_path)
    told = [code for code in found if not code.startswith("note alignment")]
    assert [code[: len(start)] for code, start in zip(told, expected, strict=True)] == expected
