"""What the doctor has found: how bad it is, what is wrong, and what to do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Level = Literal["error", "warning", "note"]


@dataclass(frozen=True)
class Finding:
    """Something about a dataset: an error spoils results, a warning may, a note is only to be known."""

    level: Level
    check: str  # which one found it
    text: str  # what is wrong, with numbers and names; one line
    advice: str  # what to do; one line, empty where there is nothing to do
