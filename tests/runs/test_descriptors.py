"""A second run encodes the timed sample alone, one on a large map asks for the best places, and its search is told."""

import gc
import re
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from little import Angles, Lookup, journey, number_in, pictures
from little_runs import asked_for, execute, kinds, run_of, table

from vprbench.api import descriptor
from vprbench.api.binary import BinaryMethod
from vprbench.api.descriptor import DescriptorMethod
from vprbench.api.images import Images
from vprbench.api.nearest import pack_bits
from vprbench.api.weights import Weights
from vprbench.errors import BadInput
from vprbench.metrics.ranking import judge_scores, rank_places
from vprbench.runs import descriptors, scorers
from vprbench.runs.descriptors import DescriptorCache
from vprbench.runs.stopwatch import Protocol, Stopwatch

pytestmark = pytest.mark.usefixtures("surroundings")

N_QUERIES, N_PLACES = 70, 80
ALL = N_QUERIES + N_PLACES
PROTOCOL = Protocol(minimum_seconds=0, minimum_queries=2, sample=2, warmup_queries=1, batch_sizes=[1])


@dataclass(kw_only=True)
class Counting(DescriptorMethod):
    """Describes an image by the angle that stands for its number, and counts the images that it was shown."""

    turn: float = 0.03
    keeps: bool = True
    weights: Weights | None = None
    encoded: int = field(default=0, init=False, compare=False)

    def encode(self, images):
        self.encoded += len(images)
        angles = np.array([number_in(image) for image in images]) * self.turn
        return np.stack([np.cos(angles), np.sin(angles)], axis=1).astype(np.float32)

    def keeps_descriptors(self):
        return self.keeps


DATASET = journey(N_QUERIES, N_PLACES)


def run(method, folder, dataset=DATASET, arguments=(), files=()):
    given = {"_target_": "Counting", "turn": 0.03, "index": "exact", "device": "cpu", **dict(arguments)}
    asked = asked_for(method, dataset, PROTOCOL, cache=folder, method=given, depth=5)
    return execute(replace(asked, files=[*map(tuple, files)]))


def encoded_for_answers(method):
    """The images that were encoded, without the first query and the timing: each lap and warm-up query shows one."""
    without = Counting()
    without.fit_descriptors(np.eye(2, dtype=np.float32), np.arange(2))
    Stopwatch(PROTOCOL).measure(without, journey(N_QUERIES, 2, [[0]] * N_QUERIES).queries)
    return method.encoded - 1 - without.encoded


@pytest.mark.parametrize(("keeps", "cached", "files"), [(True, True, 2), (True, False, 0), (False, True, 0)])
def test_the_first_run_encodes_each_image_once_and_keeps_what_is_worth_it_and_the_second_says_that_it_encodes_nothing(
    tmp_path, keeps, cached, files
):
    first, second = Counting(keeps=keeps), Counting(keeps=keeps)
    found, again = (run(method, tmp_path if cached else None) for method in (first, second))
    assert (encoded_for_answers(first), encoded_for_answers(second)) == (ALL, 0 if files else ALL)
    assert len(list(tmp_path.glob("*.npy"))) == files
    assert found.fit_seconds is not None
    assert (again.fit_seconds is None, again.load_seconds is not None) == (bool(files),) * 2
    assert np.array_equal(found.scores, again.scores)
    assert (found.outcome.above == 0).all()


def with_another_last_bit():
    """Return the dataset with one image changed in its last pixel, which a glance at some of them leaves out."""
    arrays = [image.copy() for image in DATASET.references]
    arrays[50][2, 3, 2] ^= 1
    return replace(DATASET, references=Images.from_arrays(arrays))


RENAMED = Images.from_arrays(list(DATASET.references), [f"other {i}" for i in range(N_PLACES)])


@pytest.mark.parametrize(
    ("method", "dataset", "changes", "encoded"),
    [
        (Counting(index="binary"), DATASET, {"arguments": {"index": "binary"}}, N_QUERIES),  # to audit the index
        (Counting(), DATASET, {"arguments": {"turn": 0.02}}, ALL),
        (Counting(), DATASET, {"files": [["weights.pth", "ab" * 32]]}, ALL),
        (Counting(), with_another_last_bit(), {}, N_PLACES),
        (Counting(), replace(DATASET, references=RENAMED), {}, 0),
        (Counting(), journey(40, N_PLACES), {}, 40),
    ],
    ids=["index", "argument", "weights", "changed image", "names", "other queries"],
)
def test_a_second_run_encodes_what_is_not_kept_under_its_arguments_weights_and_images(
    tmp_path, method, dataset, changes, encoded
):
    run(Counting(), tmp_path)
    run(method, tmp_path, dataset, **changes)
    assert encoded_for_answers(method) == encoded


def test_other_code_and_another_device_encode_anew_and_where_a_file_of_weights_lies_does_not_count(
    tmp_path, monkeypatch
):
    def encoded(path):
        method = Counting(weights=Weights(file="w", licence="", trained_on="", path=path))
        run(method, tmp_path, arguments={"weights": {"path": path}}, files=[[path, "ab" * 32]])
        return encoded_for_answers(method)

    assert [encoded("here"), encoded("there")] == [ALL, 0]
    for module, name in ((descriptors, "hash_class"), (descriptors.machine, "classify_device")):
        with monkeypatch.context() as patch:
            patch.setattr(module, name, lambda _: "another")
            assert encoded("here") == ALL


def test_an_index_that_cannot_be_made_is_refused_before_anything_is_encoded(tmp_path):
    for cache in (None, tmp_path):
        method = Counting(index="ivfpq")
        with pytest.raises(BadInput, match=r"ivfpq .* 256 .* 80 came"):
            run(method, cache)
        assert method.encoded == 0


N = 10
MANY = pictures([i % 100 for i in range(2000)])


def some(images):
    return np.arange(len(images) * 4, dtype=np.float32).reshape(len(images), 4)


def describe(folder, encode=some, images=pictures(range(N))):  # noqa: B008 - it does not change
    """Return the descriptors of a traverse, how many were kept, and how many images were told to be done."""
    done = []
    made, kept = DescriptorCache(folder, {"method": "m"}).descriptors(images, encode, done.append)
    return made, kept, done


@pytest.mark.parametrize("damage", [lambda whole: whole[:-20], lambda whole: b"<html>"], ids=["cut", "page"])
def test_what_was_kept_is_found_memory_mapped_and_read_only_and_a_damaged_file_is_made_anew(tmp_path, damage):
    made, *told = describe(tmp_path)
    found, *told_again = describe(tmp_path)
    assert (told, told_again) == ([0, [N]], [N, []])
    assert (isinstance(found.base, np.memmap), found.flags.writeable) == (True, False)
    assert made.tolist() == found.tolist() == some(pictures(range(N))).tolist()
    (path,) = tmp_path.glob("*.npy")
    path.with_name(f"{path.name}.part").write_bytes(b"<html>")  # in the place of an unfinished file
    path.write_bytes(damage(path.read_bytes()))
    again, kept, _ = describe(tmp_path)
    assert (kept, again.tolist()) == (0, some(pictures(range(N))).tolist())


@pytest.mark.parametrize(("after", "kept"), [(1000, 0), (1900, 1024)])
def test_an_interrupted_encoding_goes_on_after_a_stretch_with_the_same_bits(tmp_path, after, kept):
    shown = []

    def interrupted(images):
        shown.append(len(images))
        if sum(shown) > after:
            raise ZeroDivisionError
        return some(images)

    wanted, *_ = describe(tmp_path / "whole", some, MANY)
    with pytest.raises(ZeroDivisionError):
        describe(tmp_path / "cut", interrupted, MANY)
    (part,) = (tmp_path / "cut").glob("*.part")
    with part.open("ab") as file:
        file.write(b"half a row")
    found, *told, done = describe(tmp_path / "cut", some, MANY)
    assert (told, done[-1]) == ([kept], 2000 - kept)
    assert np.array_equal(found, wanted)


DEPTH = 6


def on(method):
    dataset = journey(N_QUERIES, N_PLACES, [[i, (i + 40) % N_PLACES] if i % 5 else [] for i in range(N_QUERIES)])
    return run_of(method, dataset, depth=DEPTH)


def parts(found):
    return {name: np.asarray(value).tolist() for name, value in vars(found).items()}


def test_a_large_map_is_asked_for_its_best_places_alone_when_scored_and_when_timed(monkeypatch):
    monkeypatch.setattr(scorers, "LARGE_MAP", N_PLACES - 1)

    class Shortlisted(Angles):
        def match(self, codes):
            raise AssertionError("all places were scored")

        def nearest(self, codes, n):
            return super().nearest(codes, n)

    run = on(Shortlisted())
    twenty = Angles().encode(pictures(range(20))).astype(np.float64)
    scores = (twenty @ twenty.T).astype(np.float32)[np.arange(N_QUERIES)[:, None] % 20, np.arange(N_PLACES) % 20]
    places, best = rank_places(scores, DEPTH)
    assert np.array_equal(run.top_places, places)
    np.testing.assert_allclose(run.top_scores, best, atol=1e-6)
    among = np.full((N_QUERIES, N_PLACES), -np.inf, np.float32)
    np.put_along_axis(among, places.astype(np.int64), run.top_scores, axis=1)
    assert parts(run.outcome) == parts(judge_scores(among, run.positives))
    assert (run.scores, "answers" in kinds(run)) == (None, False)
    (note,) = [note.text for note in run.notes if note.kind == "shortlist"]
    assert ("80 places" in note, f"best {DEPTH} " in note) == (True, True)


@pytest.mark.parametrize("cached", [False, True])
def test_descriptors_that_fill_the_memory_stay_in_a_file(cached, tmp_path, monkeypatch):
    monkeypatch.setenv("VPRBENCH_SCRATCH", str(tmp_path / "scratch"))
    monkeypatch.setattr(descriptor, "LARGE_BYTES", 1000)
    monkeypatch.setattr(Angles, "keeps_descriptors", lambda _: cached)
    method = Angles()
    run = execute(asked_for(method, journey(N_QUERIES, N_PLACES), cache=tmp_path / "cache"))
    assert isinstance(method.searched.references.base, np.memmap)
    folder = tmp_path / ("cache" if cached else "scratch")
    assert len([*folder.rglob("*.npy")]) == (2 if cached else 1)  # of references, and of queries
    np.testing.assert_allclose(run.scores, on(Angles()).scores, atol=1e-6)
    del method
    gc.collect()
    assert not [*(tmp_path / "scratch").rglob("*.npy")]


def searching(index, **arguments):
    """Return a run over 300 places, what it records of its search, and its notes on that."""
    run = run_of(Angles(distinct=300, index=index, **arguments), journey(300, 300))
    return run, dict(run.search), [note.text for note in run.notes if note.kind == "index"]


def test_a_run_records_and_says_how_good_its_index_is_what_is_compared_again_and_how_long_it_took():
    run, found, _ = searching("hnsw", neighbours=20)
    assert found["index"] == "hnsw"
    assert 0.9 < found["recall_at_1"] <= 1
    assert 0.9 < found["recall_at_10"] <= 1
    assert 16 * 4 + 64 * 4 <= found["bytes_per_place"] < 16 * 4 + 64 * 4 + 40  # vector, links, and where they lie
    assert np.isneginf(run.scores).sum(1).tolist() == [280] * 300
    _, found, (note,) = searching("hnsw", neighbours=5)
    assert found["recall_at_10"] == pytest.approx(0.5, abs=0.02)  # 5 of the best 10
    parts = r"index hnsw: (100\.0|9\d\.\d) % .*, (50\.0|4\d\.\d) % of the best 10; 3\d\d bytes a place, .* [\d.]+ s"
    assert re.fullmatch(parts, note)
    run, found, (note,) = searching("binary", rerank=40)
    assert (found["rerank"], found["bytes_per_place"]) == (40, 8)  # 16 bits in a word
    assert 0 < found["build_seconds"] < 60
    assert np.isneginf(run.scores).sum(1).tolist() == [260] * 300
    assert note.startswith("index binary, the best 40 ")


def test_exact_search_goes_without_saying_codes_of_bits_tell_their_bytes_and_a_match_of_its_own_records_none():
    class Signs(BinaryMethod):
        def encode(self, images):
            return pack_bits(np.stack([np.resize(image > 127, 100) for image in images]))

    assert run_of(Lookup(table(6, 4)), journey(6, 4)).search is None
    exact = {"index": "exact", "bytes_per_place": 64, "recall_at_1": 1.0, "recall_at_10": 1.0}
    assert searching("exact")[1:] == (exact, [])
    signs = run_of(Signs(), journey(6, 4))
    assert signs.search == {**exact, "bytes_per_place": 16}
    assert any("16 bytes a place" in note.text for note in signs.notes)
