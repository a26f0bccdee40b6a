"""The first file of a new method or dataset, which keeps all rules at once: vprbench new method NAME."""

from __future__ import annotations

import keyword
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from jinja2 import Template

from vprbench.errors import BadInput
from vprbench.plugins.entries import find_entries
from vprbench.plugins.options import option, parse_options

_EXAMPLES = {"method": "dataset=synthetic dataset.places=100", "dataset": "method=sad"}


@dataclass(frozen=True)
class Settings:
    """The options of `new`."""

    folder: str = option(".", "where the file goes")


def write_plugin(words: Sequence[str]) -> str:
    """Write the file of a new method or dataset.

    Args:
        words: `method NAME` or `dataset NAME`, and options of `Settings`; MyMethod gives my_method.py.

    Returns:
        The file written and the commands to try next, a line each.

    Raises:
        BadInput: the name cannot be used, or the file is there already.
    """
    settings = parse_options(Settings, [word for word in words if "=" in word])
    group, *names = [word for word in words if "=" not in word] or [""]
    if group not in _EXAMPLES or len(names) != 1:
        raise BadInput("new needs a kind and a name: vprbench new method NAME or vprbench new dataset NAME")
    name = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", names[0]).replace("-", "_").lower()
    if not re.fullmatch(r"[a-z]\w*", name, re.ASCII) or keyword.iskeyword(name):
        raise BadInput(f"new {group} {names[0]}: give letters, digits and '_', a letter first")
    path = Path(settings.folder).expanduser() / f"{name}.py"
    if path.exists() or name in find_entries("method" if group == "method" else "dataset"):
        raise BadInput(f"new {group} {names[0]}: {name} is there already: choose another name")
    target = "".join(part.capitalize() for part in name.split("_")) if group == "method" else name
    template = Path(__file__).with_name("templates") / f"{group}.py.j2"
    text = Template(template.read_text(encoding="utf-8"), keep_trailing_newline=True).render(name=name, kind=target)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    selected = f"{group}={path if path.is_absolute() else f'./{path}'}:{target}"
    commands = f"  vprbench check {selected}\n  vprbench {selected} {_EXAMPLES[group]}"
    return f"wrote {path}\nnext:\n{commands}"
