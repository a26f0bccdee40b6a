"""What the doctor has found: how bad it is, what is wrong and what to do, and how a terminal shows it."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

from vprbench.text import format_count

Level = Literal["error", "warning", "note"]
LEVELS: tuple[Level, ...] = get_args(Level)  # the worst first

_WIDTH, _MARGIN = 110, 10


@dataclass(frozen=True)
class Finding:
    """Something about a dataset: an error spoils results, a warning may, a note is only to be known."""

    level: Level
    check: str  # which check found it
    text: str  # what is wrong, with numbers and names; one line
    advice: str = ""  # what to do; one line, empty if there is nothing to do


def is_wrong(found: Sequence[Finding]) -> bool:
    """Tell whether the findings hold more than notes."""
    return any(finding.level != "note" for finding in found)


def as_text(name: str, found: Sequence[Finding]) -> str:
    """Return findings as lines of at most 110 characters, but for names that are longer; the last line counts them."""
    lines = [name]
    for finding in found:
        lines += ["", *_format_paragraph(finding.level, f"{finding.check}: {finding.text}")]
        if finding.advice:
            lines += _format_paragraph("  do", finding.advice)
    counts = [format_count(sum(finding.level == level for finding in found), level) for level in LEVELS]
    verdict = "something is wrong" if is_wrong(found) else "nothing is wrong"
    return "\n".join([*lines, "", f"{verdict}: {', '.join(counts)}"])


def _format_paragraph(title: str, text: str) -> list[str]:
    first, later = title.ljust(_MARGIN), " " * _MARGIN
    wrapper = textwrap.TextWrapper(_WIDTH, first, later, break_long_words=False, break_on_hyphens=False)
    return wrapper.wrap(text)
