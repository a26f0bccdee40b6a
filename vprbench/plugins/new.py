"""The first files of a new method or dataset, which keep all rules at once: vprbench new method NAME."""

from __future__ import annotations

import keyword
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from vprbench.errors import BadInput
from vprbench.plugins.entries import Group, entries
from vprbench.plugins.options import option, parse_options
from vprbench.text import some

_EXAMPLES = {"method": "dataset=synthetic dataset.places=100", "dataset": "method=sad"}


@dataclass(frozen=True)
class Settings:
    """Where the files of a new method or dataset go."""

    folder: str = option(".", "where the files go")
    package: bool = option(False, "true: a package to install, with a yaml of its options; false: one loose file")


def write_plugin(words: Sequence[str]) -> str:
    """Write the files of a new method or dataset.

    Args:
        words: `method NAME` or `dataset NAME`, and options of `Settings`.

    Returns:
        The files written and the commands to try next, a line each.

    Raises:
        BadInput: the name cannot be used, or a file is there already.
    """
    settings = parse_options(Settings, [word for word in words if "=" in word], {})
    kind, *names = [word for word in words if "=" not in word] or [""]
    if kind not in _EXAMPLES or len(names) != 1:
        raise BadInput("new needs a kind and a name: vprbench new method NAME or vprbench new dataset NAME")
    group: Group = "method" if kind == "method" else "dataset"
    name = _parse_name(group, names[0])
    target = "".join(part.capitalize() for part in name.split("_")) if group == "method" else name
    package, folder = f"vprbench_{name}", Path(settings.folder).expanduser()
    top, loose = folder / package.replace("_", "-"), folder / f"{name}.py"
    files = {loose: f"{group}.py"}
    install, selected = [], f"{group}={loose if loose.is_absolute() else f'./{loose}'}:{target}"
    if settings.package:
        files = {
            top / "pyproject.toml": "pyproject.toml",
            top / package / "__init__.py": "package.py",
            top / package / f"{name}.py": f"{group}.py",
            top / package / "conf" / group / f"{name}.yaml": f"{group}.yaml",
        }
        install, selected = [f"pip install -e {top}"], f"{group}={name}"
    if there := [str(path) for path in files if path.exists()]:
        raise BadInput(f"{some(there)} is there already: choose another name or folder=")
    loader = FileSystemLoader(Path(__file__).with_name("templates"))
    templates = Environment(loader=loader, undefined=StrictUndefined, keep_trailing_newline=True)
    for path, template in files.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        text = templates.get_template(f"{template}.j2").render(group=group, name=name, kind=target, package=package)
        path.write_text(text, encoding="utf-8")
    commands = (*install, f"vprbench check {selected}", f"vprbench {selected} {_EXAMPLES[group]}")
    return "\n".join([*(f"wrote {path}" for path in files), "next:", *(f"  {line}" for line in commands)])


def _parse_name(group: Group, given: str) -> str:
    """Return a name as that of a module, MyMethod as my_method; raises BadInput if it cannot be one or is taken."""
    name = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", given).replace("-", "_").lower()
    if not re.fullmatch(r"[a-z]\w*", name, re.ASCII) or keyword.iskeyword(name):
        raise BadInput(f"new {group} {given}: give letters, digits and '_', a letter first")
    if name in entries(group):
        raise BadInput(f"new {group} {given}: there is a {group} {name}: choose another name")
    return name
