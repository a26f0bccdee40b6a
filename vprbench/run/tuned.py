"""What a reader has to know of a run whose method was tuned: numbers on these places are no contest."""

from __future__ import annotations

from vprbench.run.note import Note, noted
from vprbench.run.record import Run


def tuned_here(run: Run) -> bool:
    """Tell whether a run's dataset shows the places on which the method's settings were chosen."""
    declared = run.tuned_on
    return run.dataset in (declared.get("dataset"), *declared.get("also_in", ()))


def tuned_note(run: Run) -> str:
    """Return what a reader has to know of the settings of a run's method; empty if none were chosen on a dataset."""
    if not run.tuned_on:
        return ""
    words = f"tuned on {run.tuned_on['places']} of {run.tuned_on['dataset']}"
    return f"{words}, so in no contest on {run.dataset}" if tuned_here(run) else words


def all_notes(run: Run) -> tuple[Note, ...]:
    """Return the notes of a run, before them on what its method was tuned."""
    return (*noted("tuned", filter(None, [tuned_note(run)])), *run.notes)
