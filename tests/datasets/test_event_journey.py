"""The simulated event camera: events where and when the rule of ESIM puts them, whoever asks first."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from image_folders import answer

from vprbench.api.events import hot_pixels
from vprbench.datasets import synthetic_events
from vprbench.datasets.rendering.film import HEIGHT, WIDTH
from vprbench.datasets.rendering.journey import World
from vprbench.datasets.synthetic_events import EventJourney, event_journey, write_recording

PIXELS = HEIGHT * WIDTH
EXACT = {"threshold_spread": 0, "noise_hz": 0, "refractory_us": 0, "steps": 1, "metres": 180 / 16}
BRIGHTER, DARKER = 0, 1


class Wall:
    """A wall of one grey value, which becomes 1 brighter each 1/16 metre from 20 on; place 1 darkens from 200 on."""

    def __init__(self, seed):
        self.seed = seed

    def render(self, traverse, place, ahead=0):
        return np.full((HEIGHT, WIDTH, 3), 200 - ahead if place == DARKER else 20 + ahead, np.uint8)


@pytest.fixture
def _wall(monkeypatch):
    world = World("the wall", "hour", ("spring",), (0, 1), Wall, 1)
    monkeypatch.setitem(synthetic_events._WORLDS, "synthetic", world)


def seen(place=BRIGHTER, **options):
    (events,) = EventJourney(**options).recording("spring", [place]).events()
    return events


def per_pixel(events):
    return np.bincount(events.y.astype(int) * WIDTH + events.x, minlength=PIXELS)


# The rule, on a wall whose light changes by the factor (200 + 5.1) / (20 + 5.1) in half a second: by 2.1006 in
# logarithms, so that the threshold 0.2 is crossed ten times, every 500 * 0.2 / 2.1006 = 47.6 ms.


@pytest.mark.usefixtures("_wall")
@pytest.mark.parametrize(("place", "rising"), [(BRIGHTER, True), (DARKER, False)])
def test_a_pixel_sends_an_event_whenever_the_logarithm_of_light_has_changed_by_the_threshold(place, rising):
    events = seen(place, **EXACT)
    assert (per_pixel(events) == 10).all()
    assert np.abs(events.t.reshape(10, PIXELS) - 47_605 * np.arange(1, 11)[:, None]).max() < 10
    assert (events.p == rising).all()


@pytest.mark.usefixtures("_wall")
def test_refractory_times_renderings_thresholds_noise_and_hot_pixels_are_as_the_options_say():
    for option, expected in (("refractory_us", 47_000), 10), (("refractory_us", 60_000), 5), (("steps", 9), 10):
        assert (per_pixel(seen(**EXACT | dict([option]))) == expected).all()
    spread = per_pixel(seen(**EXACT | {"threshold_spread": 0.02}))
    assert spread.min() < 9 < 11 < spread.max()
    assert np.array_equal(spread, per_pixel(seen(place=5, **EXACT | {"threshold_spread": 0.02})))  # it lasts
    still = EXACT | {"metres": 0, "noise_hz": 2.0}
    expected = 2.0 * PIXELS * 0.5
    assert abs(per_pixel(seen(**still)).sum() - expected) < 5 * expected**0.5
    counts = per_pixel(seen(**still | {"hot_pixels": 7})).reshape(HEIGHT, WIDTH)
    assert hot_pixels(counts, 10).sum() == 7


# The dataset


def test_frames_count_the_events_of_the_recording_whoever_asks_first():
    dataset = event_journey(places=12, references=["spring"], query="winter", hot_pixels=3, first_query_place=2)
    assert [recording.name for recording in dataset.recordings] == ["spring", "winter"]
    for images, recording in zip((dataset.references, dataset.queries), dataset.recordings, strict=True):
        with ThreadPoolExecutor(3) as threads:
            frames = list(threads.map(images.__getitem__, range(len(images))))
        chunks = list(recording.events())
        t, x, y = (np.concatenate([getattr(chunk, name) for chunk in chunks]) for name in "txy")
        assert (np.diff(t) >= 0).all()
        counts = np.zeros((len(images), HEIGHT, WIDTH), int)
        np.add.at(counts, (t // 500_000, y, x), 1)
        assert np.array_equal(np.minimum(8 * counts, 255), np.array(frames)[..., 0])
        assert np.array_equal(recording.middle_us, 500_000 * np.arange(len(images)) + 250_000)


@pytest.mark.parametrize(
    ("journey", "reference", "query"), [("synthetic", "spring", "fall"), ("street", "sun", "rain")]
)
def test_places_are_recognised_by_their_events_under_another_light(journey, reference, query):
    dataset = event_journey(places=20, journey=journey, references=[reference], query=query, first_query_place=0)
    counts = [np.array([frame.ravel() for frame in frames], float) for frames in (dataset.references, dataset.queries)]
    known, asked = (frames / np.linalg.norm(frames, axis=1, keepdims=True) for frames in counts)
    assert ((asked @ known.T).argmax(1) == np.arange(20)).mean() > 0.3  # a guess: 0.05


def test_another_seed_is_another_camera_on_another_journey():
    one, other = (event_journey(places=10, seed=seed).protocol for seed in (0, 1))
    assert one != other
    assert one["threshold"] == 0.2
    assert not np.array_equal(seen(noise_hz=3, seed=1).t, seen(noise_hz=3).t)


def test_a_written_recording_holds_the_events(tmp_path):
    h5py = pytest.importorskip("h5py", reason="HDF5 is written with h5py (pip install vprbench[events])")
    recording = EventJourney(steps=1).recording("fall", [3, 4])
    write_recording(tmp_path / "fall.h5", recording)
    with h5py.File(tmp_path / "fall.h5") as file:
        for name in "txyp":
            expected = np.concatenate([getattr(chunk, name) for chunk in recording.events()])
            assert np.array_equal(file["events"][name][:], expected)


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        ({"journey": "sea"}, "dataset.journey=sea: choose synthetic or street"),
        ({"threshold": 0}, "dataset.threshold=0: "),
        ({"noise_hz": float("nan")}, "dataset.noise_hz=nan: "),
        ({"hot_pixels": 20_000}, "dataset.hot_pixels=20000: give 0 to 14400"),
        ({"journey": "street"}, "the city street has sun, rain, dusk"),
    ],
)
def test_what_cannot_be_simulated_is_refused_by_its_option(asked, told):
    assert told in answer(event_journey, **asked)
