"""Judged answers as the page's script reads them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.runs.query_results import NOWHERE, Answers

_DIGITS = 5  # significant ones of a score on the page


def list_columns(answers: Answers) -> dict[str, Any]:
    """Return the answers of a run as plain values, numbers rounded, small enough for a page; None: there is none.

    An infinite margin is the text "-" or "+", for JSON has no such number.
    """
    infinite = {-np.inf: "-", np.inf: "+"}
    return {
        "verdicts": answers.verdicts,
        "places": answers.places.ravel().tolist(),
        "scores": _round_digits(answers.scores.ravel()),
        "right": answers.right_places.tolist(),
        "rightScores": _round_digits(answers.right_scores),
        "ranks": answers.ranks.tolist(),
        "equals": {int(query): int(answers.equals[query]) for query in np.flatnonzero(answers.equals)},
        "margins": [
            infinite.get(margin, short)
            for margin, short in zip(answers.margins.tolist(), _round_digits(answers.margins), strict=True)
        ],
        "bounds": answers.bounds,
    }


def format_place_ranges(places: npt.NDArray[np.int64]) -> str:
    """Return places as text, neighbours as a range.

    >>> format_place_ranges(np.array([7, 3, 4, 5]))
    '3-5, 7'
    """
    ordered = np.unique(places)
    parts = np.split(ordered, np.flatnonzero(np.diff(ordered) > 1) + 1) if len(ordered) else []
    return ", ".join(str(part[0]) if len(part) == 1 else f"{part[0]}-{part[-1]}" for part in parts)


def list_places_shown(answers: Iterable[Answers]) -> list[int]:
    """Return every place whose frame the answers show, ascending."""
    shown = {place for one in answers for part in (one.places, one.right_places) for place in part.ravel().tolist()}
    return sorted(shown - {NOWHERE})


def _round_digits(values: npt.NDArray[np.float64]) -> list[float | None]:
    """Return values to five significant digits; None if one is not finite."""
    return [float(f"{value:.{_DIGITS}g}") if np.isfinite(value) else None for value in values.tolist()]
