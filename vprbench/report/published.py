"""The paper's own facts: the machine and the numbers of its Table II, and the protocols of its datasets."""

from __future__ import annotations

import csv
from functools import cache
from pathlib import Path

PAPER = "VPRTempo (ICRA 2024), Table II"
PAPER_CPU, PAPER_GPU = "Intel i7-9700K", "Nvidia RTX 2080"

#: The places and queries of each dataset of the paper, by its name.
PROTOCOLS = {
    "Nordland": "2,700 queries of 3,300 places, fall+spring against summer, no tolerance",
    "Oxford RobotCar": "360 queries of 450 places, rain+sun against dusk, no tolerance",
}


@cache
def read_published_numbers() -> dict[tuple[str, str], dict[str, float | None]]:
    """Return the numbers of the paper's Table II, by row and dataset: R@1 in %, training in minutes, queries in Hz.

    None is its "-". Source: VPRTempo (ICRA 2024), Table II.
    """
    printed: dict[tuple[str, str], dict[str, float | None]] = {}
    with Path(__file__).with_name("published_table2.csv").open(encoding="utf-8", newline="") as file:
        for line in csv.DictReader(file):
            cells = printed.setdefault((line["method"], line["dataset"]), {})
            cells[line["metric"]] = float(line["value"]) if line["value"] else None
    return printed
