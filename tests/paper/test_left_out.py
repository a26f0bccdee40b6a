"""What a run that was left out would take, against sums by hand."""

from types import SimpleNamespace
from typing import Any

import pytest

from vprbench.paper.left_out import full_seconds

# Trained 40 s and read for 10 s; 30 queries to 20 places took 6 s: 0.01 s each
MEASURED: Any = SimpleNamespace(
    outcome=type("Outcome", (), {"n_places": 20, "__len__": lambda _: 30})(),
    fit_seconds=50.0,
    fit_compute_seconds=40.0,
    method_seconds=46.0,
)


@pytest.mark.parametrize(
    ("asks_its_map", "seconds"),
    [
        (False, 10 * 50 + 200 * 300 * 0.01),
        (True, 10 * (50 - 20 * 20 * 0.01) + 200 * 200 * 0.01 + 200 * 300 * 0.01),
    ],
)
def test_training_grows_with_the_places_and_asking_with_places_times_queries(asks_its_map, seconds):
    assert full_seconds(MEASURED, 200, 300, asks_its_map) == pytest.approx(seconds)
