"""Where and on what a figure was measured, in sentences: queries and places, machines, seeds, disturbances."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from vprbench.paper.selection import Series
from vprbench.paper.table import best
from vprbench.run.record import Run
from vprbench.run.tuned import tuned_note


def runs_of(series: Sequence[Series]) -> list[Run]:
    """Return the runs of all series."""
    return [run for one in series for run in one.runs]


def listed(names: Iterable[str]) -> str:
    """Return distinct names as a list in a sentence: "A and B", "A, B and C", or "A; B, its code; and C"."""
    *first, last = dict.fromkeys(names)
    if len(first) > 1 and any(", " in name for name in (*first, last)):
        return "; ".join([*first, f"and {last}"])
    return f"{', '.join(first)} and {last}" if first else last


def counted(number: int, thing: str) -> str:
    """Return a number with its thing, in the plural where it is not one: "3,300 places", "1 query", "360 queries"."""
    if number != 1:
        thing = f"{thing[:-1]}ies" if thing.endswith("y") else f"{thing}s"
    return f"{number:,} {thing}"


def dataset_sentence(runs: Sequence[Run]) -> str:
    """Say which dataset, how many queries and how many places the runs are of."""
    return f"Dataset {listed(_extent(run) for run in runs)}."


def machine_sentence(runs: Sequence[Run]) -> str:
    """Say which machines the runs were measured on."""
    return f"Measured on {'; '.join(dict.fromkeys(map(best.machine, runs)))}."


def seed_sentence(series: Sequence[Series], meaning: str) -> str:
    """Say which series have several seeds and what is drawn of them; empty where none has."""
    several = [f"{one.name} ({len(one.runs)} seeds)" for one in series if len(one.runs) > 1]
    return f"{listed(several)}: {meaning}." if several else ""


def tuned_sentence(series: Sequence[Series]) -> str:
    """Say of each series whose settings were chosen on a dataset on which; empty where there is none."""
    told = dict.fromkeys(f"{one.name}: {note}." for one in series for note in map(tuned_note, one.runs) if note)
    return " ".join(told)


def noise_sentence(series: Sequence[Series]) -> str:
    """Name the series whose times are disturbed or too few; empty where there are none."""
    noisy = [one.name for one in series if any(map(best.disturbed, one.runs))]
    return f"Other work disturbed the machine, or laps were too few, while {listed(noisy)} ran." if noisy else ""


def closing(series: Sequence[Series], of_seeds: str) -> tuple[str, ...]:
    """Say at the end of a caption of times on what, with how many seeds and where they were measured."""
    runs = runs_of(series)
    return dataset_sentence(runs), seed_sentence(series, of_seeds), machine_sentence(runs), noise_sentence(series)


def caption(*sentences: str) -> str:
    """Join the sentences that are not empty."""
    return " ".join(sentence for sentence in sentences if sentence)


def _extent(run: Run) -> str:
    return f"{run.dataset} ({counted(len(run.outcome), 'query')}, {counted(run.outcome.n_places, 'place')})"
