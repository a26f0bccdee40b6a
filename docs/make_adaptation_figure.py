"""Makes docs/adaptation.png from results/adaptation.csv: R@1 of each method without and with `adapt`."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import pandas as pd

matplotlib.use("Agg")
from matplotlib import pyplot as plt

ROOT = Path(__file__).parents[1]
TITLES = {
    "corridor": "Corridor: indoors, 111 queries",
    "nordland_64x32 from 1000": "Nordland 64x32: winter to summer, 1,761 queries",
}
KINDS = {  # label, marker, colour
    "none": ("as it is", "o", "#666666"),
    "references": ("mean of the references", "v", "#88ccee"),
    "running": ("mean of the queries so far", "D", "#aa3377"),
    "traverse": ("mean of all queries (offline)", "|", "#000000"),
}


def main() -> None:
    """Draw one row a method, one panel a dataset."""
    found = pd.read_csv(ROOT / "results" / "adaptation.csv")
    names = list(dict.fromkeys(found["method"]))[::-1]
    figure, panels = plt.subplots(
        1, len(TITLES), figsize=(9.5, 0.36 * len(names) + 1.4), sharey=True, layout="constrained"
    )
    for panel, (dataset, title) in zip(panels, TITLES.items(), strict=True):
        of = found[found["dataset"] == dataset].pivot(index="method", columns="adapt", values="recall_at_1").loc[names]
        panel.hlines(range(len(names)), 100 * of.min(axis=1), 100 * of.max(axis=1), color="#dddddd", lw=3, zorder=1)
        for kind, (label, marker, colour) in KINDS.items():
            panel.scatter(100 * of[kind], range(len(names)), marker=marker, color=colour, s=34, label=label, zorder=2)
        panel.set_title(title, fontsize=10)
        panel.set(xlabel="R@1 (%)", xlim=(0, 100))
        panel.set_yticks(range(len(names)), names)
        panel.grid(axis="x", color="#eeeeee")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    figure.savefig(ROOT / "docs" / "adaptation.png", dpi=110)


if __name__ == "__main__":
    main()
