"""Own recordings of event cameras, and the real frames of Brisbane-Event-VPR."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from event_recordings import by_chance, write_aedat2
from image_folders import REAL, answer, needs_real_frames, rights

from vprbench.datasets.brisbane_events_7x7 import brisbane_events_7x7
from vprbench.datasets.event_folders import event_folders
from vprbench.datasets.folders import folders
from vprbench.errors import NotThere
from vprbench.methods.sad import SAD

METRES_A_DEGREE = 110_574  # of latitude, at the equator


@pytest.fixture
def options(tmp_path, monkeypatch) -> dict[str, object]:
    """A drive of 10 s in the map, and one of 7 s."""
    monkeypatch.setenv("VPRBENCH_EVENTS", str(tmp_path / "events"))
    write_aedat2(tmp_path / "map.aedat", by_chance(4000, 1, seconds=10.0))
    write_aedat2(tmp_path / "drive.aedat", by_chance(4000, 2, seconds=7.0))
    files = {"references": [str(tmp_path / "map.aedat")], "queries": str(tmp_path / "drive.aedat")}
    return {**files, "height": 20, "width": 30, "hot_factor": None}


def track(file: Path, metres: Callable[[float], float], times: np.ndarray) -> None:
    rows = [f"{time},{metres(time) / METRES_A_DEGREE!r},0" for time in times.tolist()]
    file.with_suffix(".csv").write_text("\n".join(["time,lat,lon", *rows]) + "\n")


def test_the_frames_of_the_same_number_show_the_same_place(options) -> None:
    dataset = event_folders(**options, window_ms=500.0, tolerance=1)
    assert (dataset.n_places, len(dataset.queries)) == (19, 13)
    assert rights(dataset)[:2] == [[0, 1], [0, 1, 2]]
    assert dataset.references[0].sum() > 0
    by_number = event_folders(**options, events_per_frame=400)
    assert (by_number.n_places, [int(image[..., 0].sum()) for image in by_number.queries]) == (10, [400] * 10)


def test_positions_beside_the_files_say_what_lies_within_metres(options, tmp_path: Path) -> None:
    # The map is driven at 10 m/s from 5 s on, the other drive at 20 m/s; its positions begin at 6 s.
    track(tmp_path / "map.aedat", lambda time: 10 * time, np.arange(5.0, 16.0))
    track(tmp_path / "drive.aedat", lambda time: 20 * time - 60, np.arange(6.0, 13.0, 0.5))
    dataset = event_folders(**options, ground_truth="gps", radius_metres=12.0, unmatched="keep")
    t = [np.floor(5 + 1e-3) + np.arange(n) + 0.5 for n in (9, 6)]
    mapped, asked = 10 * t[0], 20 * t[1][t[1] > 6] - 60
    assert (dataset.n_places, len(dataset.queries)) == (9, 5)
    wanted = [np.flatnonzero(abs(mapped - metres) <= 12).tolist() for metres in asked]
    assert rights(dataset) == wanted
    assert [len(recording.positions_us) for recording in dataset.recordings] == [11, 14]


@pytest.mark.parametrize(
    ("rows", "told"),
    [
        ("time,lat,lon\n900,0,0\n999,0,0\n", "900.0 to"),
        ("time,lat,lon\n9,0,0\n8,0,0\n", "ascend"),
        ("a,b\n", "lat"),
    ],
)
def test_tables_that_do_not_fit_are_refused_by_name(options, tmp_path: Path, rows: str, told: str) -> None:
    for name in ("map.csv", "drive.csv"):
        (tmp_path / name).write_text(rows)
    message = answer(event_folders, **options, ground_truth="gps")
    assert "map." in message
    assert told in message


def test_recordings_that_are_missing_are_named(options) -> None:
    assert "dataset.references" in answer(event_folders, kind=NotThere)
    options["queries"] = "gone.h5"
    assert "gone.h5" in answer(event_folders, kind=NotThere, **options)


def lens_frames(top: Path) -> Path:
    """Put frames where the dataset looks for them: 4 of sunset2, 3 of sunset1."""
    from PIL import Image as PillowImage

    for season, n in (("sunset2", 4), ("sunset1", 3)):
        (top / season).mkdir()
        for i in range(n):
            PillowImage.new("L", (7, 7), 10 * i).save(top / season / f"images_{i:05d}.png")
    np.savez(top / "ground_truth.npz", positives=np.eye(3, 4, dtype=bool) & (np.arange(3) < 2)[:, None])
    return top


def test_brisbane_is_its_two_folders_with_their_matrix(tmp_path: Path) -> None:
    dataset = brisbane_events_7x7("brisbane", root=str(lens_frames(tmp_path)))
    assert (dataset.n_places, rights(dataset)) == (4, [[0], [1], []])
    assert "sequences of 2" in dataset.notes[-1]
    assert "sunset2" in answer(brisbane_events_7x7, name="brisbane", root=str(tmp_path / "sunset1"), kind=NotThere)


@needs_real_frames
def test_sad_finds_76_of_724_places_of_brisbane_as_through_folders() -> None:
    top = REAL / "brisbane_events_7x7"
    dataset = brisbane_events_7x7("brisbane", root=str(top))
    plain = folders(
        references=[str(top / "sunset2")],
        queries=str(top / "sunset1"),
        ground_truth=str(top / "ground_truth.npz"),
        unmatched="keep",
    )
    assert rights(dataset) == rights(plain)
    assert (dataset.n_places, len(dataset.queries), sum(map(len, dataset.positives))) == (641, 724, 822)
    sad = SAD(preprocessing="grey", height=7, width=7).fit(dataset.references, dataset.places)
    best = sad.query(dataset.queries).argmax(axis=1)
    hits = sum(place in right for place, right in zip(best, dataset.positives, strict=True))
    assert hits == 76  # 0.105 of 724, as the data's own description measured it
