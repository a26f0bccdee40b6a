"""Events are count_events into frames chunk by chunk, and frames that are kept are those that were made."""

import numpy as np
import pytest
from event_recordings import by_chance, in_chunks

from vprbench.api import Events, Images, Recording, cached_frames, count_events, event_frames, hot_pixels
from vprbench.errors import BadInput

SHAPE = (20, 30)


def counts_of(events, chosen):
    frame = np.zeros(SHAPE, int)
    np.add.at(frame, (events.y[chosen].astype(int), events.x[chosen].astype(int)), 1)
    return frame


@pytest.mark.parametrize(("window_us", "per_frame"), [(1_000, 1), (100_000, 7), (700_001, 900)])
def test_windows_count_what_a_mask_of_times_counts_and_equal_numbers_one_slice_after_the_other(window_us, per_frame):
    events = by_chance(3000)
    first = int(events.t[0])
    frames = list(count_events(in_chunks(events), *SHAPE, window_us=window_us))
    assert len(frames) == (events.t[-1] - first) // window_us
    for k, frame in enumerate(frames):
        start = first + k * window_us
        assert (frame.first_us, frame.last_us) == (start, start + window_us)
        assert np.array_equal(frame.counts, counts_of(events, (events.t >= start) & (events.t < start + window_us)))
    frames = list(count_events(in_chunks(events), *SHAPE, per_frame=per_frame))
    assert len(frames) == 3000 // per_frame
    for k, frame in enumerate(frames):
        chosen = np.arange(k * per_frame, (k + 1) * per_frame)
        assert (frame.first_us, frame.last_us) == (events.t[chosen[0]], events.t[chosen[-1]])
        assert np.array_equal(frame.counts, counts_of(events, chosen))


def at(*times, x=0):
    n = len(times)
    return Events(np.array(times), np.full(n, x, np.uint16), np.zeros(n, np.uint16), np.ones(n, bool))


def test_late_events_count_gaps_give_empty_frames_and_hot_pixels_stand_out_where_an_edge_does_not():
    frames = list(count_events([at(0, 100_000, 91_000, 450_000)], *SHAPE, window_us=100_000))
    assert [int(frame.counts.sum()) for frame in frames] == [1, 2, 0, 0]
    totals = np.random.default_rng(0).poisson(20, SHAPE)
    totals[:, 12:15] = 900  # an edge that was always there
    totals[4, 3] = totals[9, 13] = 20_000
    assert np.argwhere(hot_pixels(totals, 10.0)).tolist() == [[4, 3], [9, 13]]


@pytest.mark.parametrize(
    ("events", "counting", "named"),
    [
        (at(0, 100_000, 89_000), {"window_us": 100_000}, "89000 us"),
        (at(0, 10, x=30), {"window_us": 1_000_000}, "at 0 us, column 30"),
        (at(0, 601_000_001), {"window_us": 1_000_000}, "601000001 us"),
        *((at(), counting, "per_frame") for counting in ({}, {"window_us": 5, "per_frame": 5}, {"per_frame": 0})),
    ],
)
def test_late_events_those_outside_the_sensor_long_gaps_and_no_window_are_refused(events, counting, named):
    with pytest.raises(BadInput, match=named):
        list(count_events([events], *SHAPE, **counting))


def recording(events, reads):
    return Recording("drive", lambda: reads.append("read") or iter([events]), *SHAPE)


def test_frames_are_grey_counts_up_to_255_without_hot_pixels_and_kept(tmp_path, monkeypatch):
    monkeypatch.setenv("VPRBENCH_EVENTS", str(tmp_path / "events"))
    t = np.arange(2000) * 1000
    x, y = (np.tile(part.ravel(), 4)[:2000].astype(np.uint16) for part in np.indices(SHAPE)[::-1])
    x[::4], y[::4] = 3, 4
    reads = []
    events = Events(t, x, y, np.ones(2000, bool))
    images, middle = event_frames(recording(events, reads), {"file": 1}, None, window_us=1_500_000)
    assert (len(images), middle.tolist(), images[0].shape) == (1, [750_000], (*SHAPE, 3))
    assert images[0][4, 3].tolist() == [255] * 3
    cold, _ = event_frames(recording(events, reads), {"file": 1}, 10.0, window_us=1_500_000)
    assert cold[0][4, 3].tolist() == [0] * 3
    assert np.array_equal(cold[0][5:], images[0][5:])
    assert cold.fingerprint() != images.fingerprint()
    assert reads == ["read"]
    event_frames(recording(events, reads), {"file": 2}, None, window_us=1_500_000)
    assert reads == ["read"] * 2
    assert len(list((tmp_path / "events").iterdir())) == 2
    with pytest.raises(BadInput, match="drive"):
        event_frames(recording(at(0, 5), []), {}, None, window_us=10)


def test_frames_are_made_once_and_read_in_any_order_and_other_frames_have_their_own_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("VPRBENCH_FRAMES", str(tmp_path))
    made, frames = [], np.random.default_rng(0).integers(0, 256, (2, 12, 4, 5, 3), np.uint8)  # of two seeds

    def shown(seed):
        def read(number):
            made.append(seed)
            return frames[seed][number]

        return cached_frames(Images(read, [str(i) for i in range(12)]), {"seed": seed})

    order, images = np.random.default_rng(1).permutation(12), shown(0)
    np.testing.assert_array_equal(np.stack([images[i] for i in order]), frames[0][order])
    for seed in (0, 1, 0, 1):
        np.testing.assert_array_equal(np.stack(list(shown(seed))), frames[seed])
    assert sorted(made) == [0] * 12 + [1] * 12
