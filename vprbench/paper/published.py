"""The paper's own facts: the machine and the numbers of its Table II, and the protocols of its datasets."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

PAPER = "VPRTempo (ICRA 2024), Table II"
PAPER_CPU, PAPER_GPU = "Intel i7-9700K", "Nvidia RTX 2080"


@dataclass(frozen=True)
class PaperProtocol:
    """The places and queries of a dataset in the paper, which allows no tolerance."""

    places: int
    queries: int
    references: frozenset[str]
    query: str


#: By the name of the dataset in the paper.
PROTOCOLS = {
    "Nordland": PaperProtocol(3300, 2700, frozenset({"spring", "fall"}), "summer"),
    "Oxford RobotCar": PaperProtocol(450, 360, frozenset({"sun", "rain"}), "dusk"),
}


def published() -> dict[tuple[str, str], dict[str, float | None]]:
    """Return what the paper printed in Table II, by row and dataset: R@1 in %, training in minutes, queries in Hz.

    None is its "-". Source: VPRTempo (ICRA 2024), Table II.
    """
    printed: dict[tuple[str, str], dict[str, float | None]] = {}
    with Path(__file__).with_name("published_table2.csv").open(encoding="utf-8", newline="") as file:
        for line in csv.DictReader(file):
            cells = printed.setdefault((line["method"], line["dataset"]), {})
            cells[line["metric"]] = float(line["value"]) if line["value"] else None
    return printed
