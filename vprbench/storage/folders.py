"""The folders of a person: paths below a home, of downloaded datasets, and of caches."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import platformdirs

import vprbench
from vprbench.errors import BadInput


def expanded(option: str, path: str) -> Path:
    """Return a path with its ~ resolved; raises BadInput, naming the option, if that home is not known."""
    try:
        return Path(path).expanduser()
    except RuntimeError as error:
        raise BadInput(
            f"{option}={path}: the home of {path.split('/')[0]} is not known, write the whole path"
        ) from error


def require_homes(options: Mapping[str, Any], above: str = "") -> None:
    """Raise BadInput for a path in a home that is not known, as in ~nobody/frames."""
    for name, value in options.items():
        if isinstance(value, Mapping):
            require_homes(value, f"{above}{name}.")
        for text in value if isinstance(value, list) else [value]:
            if isinstance(text, str) and text.startswith("~"):
                expanded(f"{above}{name}", text)


def cache_folder(variable: str, name: str) -> Path:
    """Return the folder that an environment variable names, or one of this name in the person's cache.

    Raises BadInput if neither is known.
    """
    chosen = os.environ.get(variable)
    if chosen:
        return expanded(variable, chosen)
    try:
        return platformdirs.user_cache_path("vprbench", appauthor=False).expanduser() / name
    except RuntimeError as error:
        raise BadInput(f"nobody knows the home of this user: set HOME, or {variable} to a folder") from error


def checkout_folder() -> Path:
    """Return the folder that holds this package: the checkout if it runs from a checkout."""
    return Path(vprbench.__file__).resolve().parents[1]


def data_folder(name: str) -> Path:
    """Return the folder of a dataset: `data/<name>` where the command runs, or below the folder VPRBENCH_DATA names."""
    return expanded("VPRBENCH_DATA", os.environ.get("VPRBENCH_DATA") or "data") / name
