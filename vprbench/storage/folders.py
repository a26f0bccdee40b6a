"""The folders of a person: paths below a home, of downloaded datasets, and of caches."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import platformdirs

import vprbench
from vprbench.errors import BadInput


def require_homes(options: Mapping[str, Any], above: str = "") -> None:
    """Raise BadInput for a path in a home that is not known, as in ~nobody/frames."""
    for name, value in options.items():
        if isinstance(value, Mapping):
            require_homes(value, f"{above}{name}.")
        for text in value if isinstance(value, list) else [value]:
            if isinstance(text, str) and text.startswith("~"):
                with _explain_unknown_home(f"{above}{name}", text):
                    Path(text).expanduser()


def cache_folder(variable: str, name: str) -> Path:
    """Return the folder that an environment variable names, or one of this name in the person's cache.

    Raises BadInput if neither is known.
    """
    chosen = os.environ.get(variable)
    with _explain_unknown_home(variable, chosen):
        folder = Path(chosen) if chosen else platformdirs.user_cache_path("vprbench", appauthor=False) / name
        return folder.expanduser()


def checkout_folder() -> Path:
    """Return the folder that holds this package: the checkout if it runs from a checkout."""
    return Path(vprbench.__file__).resolve().parents[1]


def data_folder(name: str) -> Path:
    """Return the folder of a dataset: `data/<name>` where the command runs, or below the folder VPRBENCH_DATA names."""
    return Path(os.environ.get("VPRBENCH_DATA") or "data").expanduser() / name


@contextmanager
def _explain_unknown_home(option: str, value: str | None) -> Iterator[None]:
    try:
        yield
    except RuntimeError as error:
        raise BadInput(f"{option}={value or ''}: no home is known: set HOME, or {option} to a whole path") from error
