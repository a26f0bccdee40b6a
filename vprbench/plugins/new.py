"""The first files of a new method or dataset, which keep all rules at once: vprbench new method NAME."""

from __future__ import annotations

import keyword
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from vprbench.errors import BadInput
from vprbench.plugins.entries import Group, entries
from vprbench.plugins.options import chosen, option
from vprbench.text import some

_TEMPLATES = Environment(
    loader=FileSystemLoader(Path(__file__).with_name("templates")),
    undefined=StrictUndefined,
    keep_trailing_newline=True,
)


@dataclass(frozen=True)
class Settings:
    """Where the files of a new method or dataset go."""

    folder: str = option(".", "where the files go")
    package: bool = option(False, "true: a package to install, with a yaml of its options; false: one loose file")


def new(words: Sequence[str]) -> str:
    """Write the files that `method NAME` or `dataset NAME` and options ask for; returns what was done and comes next.

    Raises BadInput for a name that cannot be used, and if a file is there already.
    """
    group, *names = [word for word in words if "=" not in word] or [""]
    if group not in get_args(Group) or len(names) != 1:
        raise BadInput("new needs a kind and a name: vprbench new method NAME or vprbench new dataset NAME")
    settings = chosen(Settings, [word for word in words if "=" in word], {})
    kind: Group = "method" if group == "method" else "dataset"
    name = _usable(kind, names[0])
    files = _files(kind, name, settings)
    if there := [str(path) for path in files if path.exists()]:
        raise BadInput(f"{some(there)} is there already: choose another name or folder=")
    for path, text in files.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    if settings.package:
        first, asked = [f"pip install -e {next(iter(files)).parent}"], f"{kind}={name}"
    else:
        path = next(iter(files))
        first, asked = [], f"{kind}={path if path.is_absolute() else f'./{path}'}:{_called(kind, name)}"
    other = "dataset=synthetic dataset.places=100" if kind == "method" else "method=sad"
    then = (*first, f"vprbench check {asked}", f"vprbench {asked} {other}")
    return "\n".join([*(f"wrote {path}" for path in files), "next:", *(f"  {line}" for line in then)])


def _usable(group: Group, given: str) -> str:
    """Return a name as that of a module, MyMethod as my_method; raises BadInput if it cannot be one or is taken."""
    name = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", given).replace("-", "_").lower()
    if not re.fullmatch(r"[a-z]\w*", name, re.ASCII) or keyword.iskeyword(name):
        raise BadInput(f"new {group} {given}: give letters, digits and '_', a letter first")
    if name in entries(group):
        raise BadInput(f"new {group} {given}: there is a {group} {name}: choose another name")
    return name


def _called(group: Group, name: str) -> str:
    """Return the name of the class or function in the file."""
    return "".join(part.capitalize() for part in name.split("_")) if group == "method" else name


def _files(group: Group, name: str, settings: Settings) -> dict[Path, str]:
    """Return what is written, by path; the file of a loose method or the pyproject.toml of a package is the first."""
    package, folder = f"vprbench_{name}", Path(settings.folder).expanduser()
    values = {"group": group, "name": name, "kind": _called(group, name), "package": package}
    written = {folder / f"{name}.py": f"{group}.py"}
    if settings.package:
        top = folder / package.replace("_", "-")
        written = {
            top / "pyproject.toml": "pyproject.toml",
            top / package / "__init__.py": "package.py",
            top / package / f"{name}.py": f"{group}.py",
            top / package / "conf" / group / f"{name}.yaml": f"{group}.yaml",
        }
    return {path: _TEMPLATES.get_template(f"{template}.j2").render(values) for path, template in written.items()}
