"""The stopwatch against a fake clock, a fake device and methods whose times are known."""

import contextlib
import gc
import itertools
import time

import numpy as np
import pytest
from little import Lookup, picture, pictures
from stopped_clock import Clock

from vprbench.api.images import Images
from vprbench.config import make_request
from vprbench.errors import BadInput
from vprbench.runs import stopwatch
from vprbench.runs.stopwatch import Protocol, Stopwatch

pytestmark = pytest.mark.usefixtures("surroundings")

MS = 1_000_000  # nanoseconds


class Timed(Lookup):
    """Spends on each call what `encode_costs` and `match_costs` make of the numbers of the images, in nanoseconds."""

    def __init__(self, spend=lambda _: None, encode_costs=lambda _: 3 * MS, match_costs=lambda _: 1 * MS):
        super().__init__(np.eye(20, dtype=np.float32))
        self.spend, self.encode_costs, self.match_costs = spend, encode_costs, match_costs

    def encode(self, images):
        codes = super().encode(images)
        self.spend(self.encode_costs(codes.tolist()))
        return codes

    def match(self, codes):
        self.spend(self.match_costs(codes.tolist()))
        return super().match(codes)


def short(**changes):
    """Return a protocol without warm-up and with a single pass."""
    small = {"minimum_seconds": 0, "minimum_queries": 1, "warmup_queries": 0, "batch_sizes": [1]}
    return Protocol(**{**small, **changes})


def measured(protocol, *costs, images=5, seed=0):
    """Measure a method whose costs are known; returns the times and what was asked."""
    clock = Clock()
    method = Timed(lambda nanoseconds: clock.spend(nanoseconds / 1e9), *costs)
    return Stopwatch(protocol, clock, seed=seed).measure(method, pictures(range(images))), method.asked


def streamed(timing, asked):
    """Return the single images asked in the streaming laps of a measurement without warm-up."""
    return [number for (number,) in asked[: len(timing.streaming.encode_seconds)]]


def test_a_streaming_rate_is_of_the_median_an_offline_rate_of_the_sum_and_the_best_batch_of_the_highest_rate():
    assert stopwatch.compute_streaming_rate(np.array([0.001, 0.002, 0.010])) == 500
    assert stopwatch.compute_offline_rate(np.array([0.1, 0.3]), 8) == pytest.approx(40)
    costs = {1: 10, 2: 12, 4: 40}  # ms: 100, 167 and 100 images per second
    timing, _ = measured(short(batch_sizes=[1, 2, 4]), lambda numbers: costs[len(numbers)] * MS, lambda _: 0, images=8)
    assert stopwatch.find_fastest_batch(timing.offline).images_per_call == 2


def test_batches_are_whole_and_hold_no_more_than_the_sample_nor_than_a_gibibyte_and_it_no_more_than_its_bytes(
    monkeypatch,
):
    large = type("Large", (Timed,), {"code_bytes": 300 << 20})
    for method, asked, images, held in ((Timed(), [2, 32, 128], 5, [2, 5]), (large(), [1, 2, 4, 8], 8, [1, 2, 3])):
        timing = Stopwatch(short(batch_sizes=asked, minimum_passes=3)).measure(method, pictures(range(images)))
        assert [laps.images_per_call for laps in timing.offline] == held
        assert {len(numbers) for numbers in method.asked} == {1, *held}
    monkeypatch.setattr(stopwatch, "_SAMPLE_BYTES", 4 * pictures([0])[0].nbytes)
    assert measured(short(sample=16), images=20)[0].sample.tolist() == [0, 6, 12, 19]


def test_by_the_real_clock_calls_last_at_least_as_long_as_a_method_slept_and_all_no_longer_than_it_took():
    began = time.perf_counter()
    method = Timed(lambda nanoseconds: time.sleep(nanoseconds / 1e9), lambda _: 5 * MS, lambda _: 2 * MS)
    streaming = Stopwatch(short()).measure(method, pictures(range(5))).streaming
    assert (streaming.encode_seconds.min() >= 0.005, streaming.match_seconds.min() >= 0.002) == (True, True)
    assert 5 * 0.007 <= streaming.total_seconds.sum() <= time.perf_counter() - began


def test_work_that_calls_and_laps_leave_on_the_device_counts_and_work_queued_before_does_not():
    clock = Clock()
    queued = []

    def synchronise():
        clock.now += sum(queued)
        queued.clear()

    method = Timed(queued.append, lambda _: 3 * MS, lambda _: 1 * MS)
    watch = Stopwatch(short(warmup_queries=1), clock, synchronise)
    queued.append(500 * MS)
    assert watch.first_query(method, pictures(range(5))) == pytest.approx(0.004)
    queued.append(500 * MS)
    timing = watch.measure(method, pictures(range(5)))
    assert timing.streaming.encode_seconds.tolist() == [0.003] * 5
    assert timing.streaming.match_seconds.tolist() == [0.001] * 5
    queued.append(500 * MS)
    with watch.lap() as lap:
        clock.now += 7 * MS
        queued.append(2 * MS)
    assert lap == [0.009]


@pytest.mark.parametrize(("enabled", "broken"), [(True, True), (False, False)])
def test_no_garbage_is_collected_in_timed_calls_and_the_collector_is_afterwards_as_it_was(enabled, broken):
    quiet = []

    def collections():
        return [generation["collections"] for generation in gc.get_stats()]

    def spend(_):
        before = collections()
        for _ in range(1000):  # more cycles than the collector waits for
            cycle = []
            cycle.append(cycle)
        quiet.append(collections() == before)
        if broken:
            raise ZeroDivisionError

    (gc.enable if enabled else gc.disable)()
    try:
        with contextlib.suppress(ZeroDivisionError):
            Stopwatch(short()).measure(Timed(spend), pictures(range(5)))
        assert (gc.isenabled(), {*quiet}) == (enabled, {True})
    finally:
        gc.enable()


def test_warm_up_ends_after_ten_queries_within_ten_percent_or_at_the_maximum():
    for first, costs, most, queries in (
        ([], [3], 50, 10),
        ([100], [3], 50, 11),  # a slow one is no longer among the last ten
        ([], [90, 99], 50, 10),  # within ten percent
        ([], [1, 2], 25, 25),
    ):
        laps = itertools.chain(first, itertools.cycle(costs))
        timing, _ = measured(short(warmup_queries=most), lambda _, laps=laps: next(laps) * MS)
        assert timing.warmup_queries == queries
        assert timing.streaming.encode_seconds.max() <= max(costs) / 1000  # of warm-up queries there is none


def test_laps_go_on_for_each_minimum_and_offline_ones_count_images_and_end_at_the_maximum_in_the_middle_of_a_pass():
    for minimum, streaming, batch, calls in (
        ({"minimum_seconds": 0.099}, 25, 5, 25),  # 0.1 s / 4 ms
        ({"minimum_queries": 12}, 15, 5, 3),  # whole passes
        ({"minimum_passes": 3}, 15, 2, 6),  # whole batches
    ):
        timing, _ = measured(short(**minimum, batch_sizes=[batch]))
        assert (len(timing.streaming.total_seconds), len(timing.offline[0].total_seconds)) == (streaming, calls)
        assert (timing.streaming.valid, timing.offline[0].valid) == (True, True)
    timing, _ = measured(short(maximum_seconds=0.002), images=1)  # the last call meets all minima, beyond the maximum
    assert (timing.streaming.valid, timing.offline[0].valid) == (True, True)
    timing, asked = measured(short(maximum_seconds=0.03), images=12)
    assert len(timing.streaming.total_seconds) == 8  # the first end after 30 ms is at 32 ms
    assert (timing.streaming.valid, timing.offline[0].valid) == (False, False)
    assert np.flatnonzero(timing.answers >= 0).tolist() == sorted(streamed(timing, asked))


def test_each_pass_asks_each_sampled_image_once_in_an_order_that_the_seed_shuffles_and_keeps_its_best_place():
    first, again, other = (streamed(*measured(short(minimum_passes=3), images=12, seed=seed)) for seed in (4, 4, 5))
    assert first == again != other
    assert first[:12] != list(range(12))
    assert [sorted(first[start : start + 12]) for start in (0, 12, 24)] == [list(range(12))] * 3
    timing, _ = measured(short(sample=3), images=9)
    assert (timing.sample.tolist(), timing.answers.tolist()) == ([0, 4, 8], [0, 4, 8])


def test_images_are_decoded_before_the_clock_runs():
    clock, reads = Clock(), []

    def read(i):
        reads.append(clock.now)
        return picture(i)

    method = Timed(lambda nanoseconds: clock.spend(nanoseconds / 1e9))
    Stopwatch(short(), clock).measure(method, Images(read, ["a", "b", "c"]))
    assert (len(reads) >= 3, {*reads}) == (True, {0})


def test_the_first_batch_of_each_size_is_not_timed():
    first = dict.fromkeys((1, 2, 4), 100 * MS)
    protocol = short(batch_sizes=[2, 4], minimum_queries=8)
    timing, _ = measured(protocol, lambda images: first.pop(len(images), 3 * MS), images=8)
    assert [laps.encode_seconds.tolist() for laps in timing.offline] == [[0.003] * 4, [0.003] * 2]


def test_the_bound_of_a_percentile_is_the_lap_with_h_above_it():
    for share, counts in {  # of spec timing.md 2.3
        0.9: {0: None, 1: None, 63: None, 64: 1, 360: 22, 2700: 233},
        0.99: {661: None, 662: 1, 2700: 15},
        0.999: {6636: 1},
    }.items():
        for count, above in counts.items():
            seconds = np.random.default_rng(0).permutation(count).astype(np.float64) + 1  # 1 to count
            assert stopwatch.estimate_percentile_bound(seconds, share) == (None if above is None else count - above)


def test_a_protocol_that_measures_nothing_is_refused_by_name():
    for option, values in {
        **{option: [0] for option in ("minimum_queries", "minimum_passes", "sample")},
        "batch_sizes": [[], [8, 0]],
        "minimum_seconds": [-1.0, 121.0, float("nan")],
        "maximum_seconds": [0.0, 0.5, float("nan")],
    }.items():
        for value in values:
            with pytest.raises(BadInput, match=rf"timing\.{option}\b"):
                make_request([], {f"timing.{option}": value})
