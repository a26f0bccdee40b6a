"""Write what pytest-benchmark measured as Markdown: report.py bench.json bench.md."""

import json
import sys
from itertools import groupby
from pathlib import Path

import torch

from vprbench.metrics.growth import fit_power
from vprbench.runs import machine
from vprbench.runs.rows import format_markdown
from vprbench.storage.atomic import replace_text
from vprbench.storage.cores import count_cores

_OWN = ("what", "images", "calls", "beside", "places", "grows", "n_codes")
_INTRODUCTION = """# How fast this machine is

Medians of rounds, each a burst of calls of 0.1 s or one longer call; a call beside it is timed in turn with it, in the
same process. *spread* is the range between the quartiles, as a share of the median.
"""


def figures(value):
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def row(measured):
    about, stats = measured["extra_info"], measured["stats"]
    seconds = stats["median"] / about["calls"]
    others = about["beside"].items()
    return {
        "": about["what"],
        "ms a call": figures(1000 * seconds),
        "Hz": figures(about["images"] / seconds),
        "spread": f"{100 * stats['iqr'] / stats['median']:.0f} %",
        **{name: each if isinstance(each, str) else f"{each:,}" for name, each in about.items() if name not in _OWN},
        "beside": ", ".join(
            f"{name} {figures(1000 * other)} ms ({figures(seconds / other)}x)" for name, other in others
        ),
    }


def growth(measured):
    """Yield how times grow with the places: t = a n^b."""
    grown = [each for each in measured if "grows" in each["extra_info"]]
    for title, few in groupby(grown, lambda each: each["extra_info"]["grows"]):
        points = [(each["extra_info"]["places"], each["stats"]["median"] / each["extra_info"]["calls"]) for each in few]
        found = fit_power(*zip(*points, strict=True))
        ends = f"[{found.low:.2f}, {found.high:.2f}] from {points[0][0]:,} to {points[-1][0]:,} places"
        yield f"{title}: n^{found.exponent:.2f} {ends}"


def document(results):
    parts = [_INTRODUCTION]
    for group, found in groupby(results["benchmarks"], lambda each: each["group"]):
        few = list(found)
        rows = [row(each) for each in few]
        if not any(each["beside"] for each in rows):
            rows = [{name: text for name, text in each.items() if name != "beside"} for each in rows]
        parts += [f"## {group.strip().rstrip('.')}", format_markdown(rows), *growth(few)]
    here = machine.describe_machine("cuda" if torch.cuda.is_available() else "cpu", count_cores())
    loads = ", ".join(f"{load:.2f}" for load in here["load_average"])
    return (
        "\n\n".join(
            [
                *parts,
                "## Machine",
                f"{machine.Machine.of(here).line}.",
                f"{machine.format_versions(here)}. {here['time_utc']}.",
                f"Load average afterwards {loads}.",
            ]
        )
        + "\n"
    )


if __name__ == "__main__":
    given, target = map(Path, sys.argv[1:])
    text = document(json.loads(given.read_text(encoding="utf-8")))
    replace_text(target, text)
    print(text, f"\nwritten to {target}")
