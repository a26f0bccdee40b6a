"""A Markdown document from the template beside the code that fills it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from vprbench.runs.rows import markdown


def document(template: Path, **values: Any) -> str:
    """Return a Jinja template with its values; `rows | table` makes a table, and absent parts leave no gap.

    Raises jinja2.UndefinedError for a name without a value.
    """
    from jinja2 import Environment, StrictUndefined

    environment = Environment(undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters["table"] = markdown
    text = environment.from_string(template.read_text(encoding="utf-8")).render(**values)
    return re.sub(r"\n{3,}", "\n\n", text).strip() + "\n"
