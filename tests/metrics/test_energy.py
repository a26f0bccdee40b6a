"""The 45 nm estimate and the synaptic operations, worked by hand."""

from __future__ import annotations

import pytest

from vprbench.api.arithmetic import Arithmetic
from vprbench.metrics.energy import estimated_joules, synaptic_operations


@pytest.mark.parametrize(
    ("arithmetic", "picojoules"),
    [
        ([Arithmetic(1000, 0)], 4600),  # Horowitz: 3.7 + 0.9
        ([Arithmetic(0, 1000)], 900),
        ([Arithmetic(1000, 1000, "int8")], 330),  # 0.2 + 0.1 of a sum in 32 bits; 0.03
        ([Arithmetic(10, 0), Arithmetic(10, 10, "int64")], 79),  # 0.1 + 3.1; 0.1
    ],
)
def test_arithmetic_costs_what_the_table_says(arithmetic: list[Arithmetic], picojoules: float) -> None:
    assert 1e12 * estimated_joules(arithmetic) == pytest.approx(picojoules)


def test_synaptic_operations_add_up_by_their_kind_over_the_layers_that_lead_on() -> None:
    layers = [
        {"synops": 5.0, "operation": "AC"},
        {"synops": 7.0, "operation": "MAC"},
        {"synops": 1.5, "operation": "AC"},
    ]
    assert synaptic_operations({"layers": [*layers, {"name": "output"}]}) == (6.5, 7.0)
    assert synaptic_operations({"layers": [{"name": "output"}]}) is None
    assert synaptic_operations(None) is None
