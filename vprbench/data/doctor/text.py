"""What the doctor says: findings as text for a terminal, as plain data, and as an exit code."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Literal

from vprbench.api.dataset import Dataset
from vprbench.errors import BadInput
from vprbench.text import plural

from .examination import examine
from .finding import Finding

_WIDTH = 110
_MARGIN = 10


def command(
    name: str,
    build: Callable[[], Dataset],
    write: Callable[[str], None],
    output: Literal["text", "json"] = "text",
) -> int:
    """Examine the dataset that `build` makes and write what was found; returns 1 for errors or warnings, 0 for none.

    A dataset that cannot be built is a finding too.
    """
    title = name
    try:
        dataset = build()
        folders = ", ".join(dict.fromkeys(str(folder.path) for folder in dataset.folders))
        title = f"{name}: {folders}" if folders else name
        found = examine(dataset)
    except BadInput as error:
        found = (Finding("error", "dataset", str(error), ""),)
    write(json.dumps(as_data(found)) if output == "json" else as_text(title, found))
    return 1 if any(finding.level != "note" for finding in found) else 0


def as_data(found: Sequence[Finding]) -> list[dict[str, str]]:
    """Return findings as data that JSON can hold."""
    return [asdict(finding) for finding in found]


def as_text(name: str, found: Sequence[Finding]) -> str:
    """Return findings as lines of at most 110 characters, but for names that are longer; the last line counts them."""
    lines = [name]
    for finding in found:
        lines += ["", *_paragraph(finding.level, f"{finding.check}: {finding.text}")]
        if finding.advice:
            lines += _paragraph("  do", finding.advice)
    counts = [plural(sum(finding.level == level for finding in found), level) for level in ("error", "warning", "note")]
    verdict = "something is wrong" if any(finding.level != "note" for finding in found) else "nothing is wrong"
    return "\n".join([*lines, "", f"{verdict}: {', '.join(counts)}"])


def _paragraph(title: str, text: str) -> list[str]:
    return textwrap.wrap(
        text,
        _WIDTH,
        initial_indent=title.ljust(_MARGIN),
        subsequent_indent=" " * _MARGIN,
        break_long_words=False,
        break_on_hyphens=False,
    )
