"""The words of this room lie in Jinja templates: code gives them values, and they make sentences and documents."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined, select_autoescape

from vprbench.paper.published import PAPER, PAPER_CPU, PAPER_GPU
from vprbench.runs.recall_intervals import METHOD
from vprbench.text import plural


def listed(names: Iterable[str], last: str = "and") -> str:
    """Return distinct names as a list in a sentence: "A and B", "A, B and C", or "A; B, its code; and C"."""
    *first, end = dict.fromkeys(names)
    if len(first) > 1 and any(", " in name for name in (*first, end)):
        return "; ".join([*first, f"{last} {end}"])
    return f"{', '.join(first)} {last} {end}" if first else end


def one_line(text: str) -> str:
    """Return text on one line, without control characters."""
    return " ".join("".join(sign if sign.isprintable() else " " for sign in text).split())


ENVIRONMENT = Environment(
    loader=FileSystemLoader(Path(__file__).parent),
    autoescape=select_autoescape(["html", "html.j2"]),
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
)
ENVIRONMENT.filters |= {"listed": listed, "one_line": one_line, "counted": plural}
ENVIRONMENT.globals |= {"METHOD": METHOD, "PAPER": PAPER, "PAPER_CPU": PAPER_CPU, "PAPER_GPU": PAPER_GPU}
_LATEX = ENVIRONMENT.overlay(
    block_start_string="<%", block_end_string="%>", variable_start_string="<<", variable_end_string=">>"
)


def document(template: str, **values: Any) -> str:
    """Return a template, by its path in this room, with its values; raises UndefinedError for a name without one."""
    environment = _LATEX if template.endswith(".tex.j2") else ENVIRONMENT
    return environment.get_template(template).render(**values)


def sentences(template: str, macro: str, *values: Any, **named: Any) -> list[str]:
    """Return the sentences that a macro of a template makes of its values: its lines that are not empty."""
    module = ENVIRONMENT.get_template(template).make_module()  # `module` keeps the globals that its first use found
    made = str(getattr(module, macro)(*values, **named))
    return [line.strip() for line in made.split("\n") if line.strip()]
