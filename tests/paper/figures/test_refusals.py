"""Every figure refuses what it cannot draw: no runs, runs on different data, queries without a right place."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import little
import pytest
from checkout import ROOT
from figure_runs import series

from vprbench.errors import BadInput
from vprbench.paper.figures.accuracy import precision_recall, recall_at_n, recall_at_tolerance
from vprbench.paper.figures.growth import growth
from vprbench.paper.figures.pictures import frames, similarity
from vprbench.paper.figures.speed import query_rate, training_time
from vprbench.paper.figures.spikes import spike_statistics
from vprbench.paper.figures.style import Drawn
from vprbench.paper.figures.tradeoff import against_memory, against_rate
from vprbench.paper.plan import read_plan
from vprbench.run.thumbnails import Thumbnails

PLAN = read_plan(ROOT / "conf" / "table.yaml")
ACCURACY = (precision_recall, recall_at_n, recall_at_tolerance, against_rate, against_memory)
SPIKING = {"spikes": {"queries": 4, "layers": [little.a_layer("output", 100, [1, 2, 3, 4], 0.5, None)]}}
UNTIMED = [series("SAD", little.a_run(timing=None))]
FIRST = series("VPRTempo", little.a_run(**SPIKING))


@pytest.mark.parametrize("draw", [*ACCURACY, spike_statistics])
@pytest.mark.parametrize("other", [{"fingerprint": "e" * 64}, {"protocol": {"tolerance_places": 1}}])
def test_runs_on_other_images_or_of_another_protocol_are_never_one_figure(draw: Any, other: dict[str, Any]) -> None:
    with pytest.raises(BadInput, match="different data"):
        draw([FIRST, series("GCL", little.a_run(**SPIKING, **other))])


@pytest.mark.parametrize(
    ("draw", "given", "culprit"),
    [
        *((draw, [], "no stored runs") for draw in ACCURACY),
        *((draw, [series("SAD", little.unanswerable_run())], "journey has a right place") for draw in ACCURACY),
        (spike_statistics, [series("SAD", little.a_run(spikes=None))], "holds spikes"),
        (growth, [], "no growth"),
        (lambda rows: training_time(rows, (), [*PLAN.rows.values()], PLAN.columns["nordland"], {}), (), "Nordland"),
        (against_rate, UNTIMED, "no timed runs .*timing=quick"),
        (lambda rows: query_rate(rows, (), [*PLAN.rows.values()], PLAN.columns["nordland"], {}), UNTIMED, "Nordland"),
        (lambda kept: frames(kept, "Railway"), Thumbnails((), (), (), (), ()), "Railway"),
        (similarity, little.a_run(scores=None), "0123456789abcdef of little on journey .*4 queries x 10 places"),
    ],
)
def test_what_cannot_be_drawn_is_refused_by_name(draw: Callable[[Any], Drawn], given: Any, culprit: str) -> None:
    with pytest.raises(BadInput, match=culprit):
        draw(given)
