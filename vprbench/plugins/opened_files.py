"""Which data files a method opens that its `files()` do not name, so that another content of them is not missed."""

from __future__ import annotations

import inspect
import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from vprbench.api.method import Method

_CODE = (".py", ".pyc", ".nbi", ".nbc", ".so", ".pyd", ".dll")
_SYSTEM = ("/proc/", "/sys/", "/dev/", "/etc/", "/usr/")
_FRAMES = str(Path("vprbench", "api", "images.py"))  # by which images are read
_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT


class Opened(NamedTuple):
    """A file that was opened to be read."""

    path: str
    by: frozenset[str]  # the files of the code that led there


_listeners: list[list[Opened]] = []


@contextmanager
def listening() -> Iterator[list[Opened]]:
    """Collect the files that Python code opens to be read in the block; libraries in other languages are not heard."""
    _hear()
    heard: list[Opened] = []
    _listeners.append(heard)
    try:
        yield heard
    finally:
        _listeners[:] = [one for one in _listeners if one is not heard]


def files_behind(method: Method, arguments: Mapping[str, Any], opened: Iterable[Opened]) -> list[Path]:
    """Return the files that a method's answers come from: its `files()`, those of its arguments, and those `opened`.

    Raises BadInput as `files()` does.
    """
    known = [*method.files()]
    named = [*map(Path, _texts(arguments)), *unnamed_files(opened, method)]
    return [*known, *_others(named, known)]


def names_a_file(arguments: Mapping[str, Any]) -> bool:
    """Tell whether any of a method's arguments names a file that is there."""
    return bool(_others(map(Path, _texts(arguments)), ()))


def unnamed_files(opened: Iterable[Opened], method: Method) -> list[Path]:
    """Return the data files that the code of a method opened and its `files()` do not name, each once.

    Code, images, and what Python and the system bring do not count.
    """
    with suppress(TypeError, OSError):  # of a class without a file nothing is known
        own = inspect.getfile(type(method))
        ours = [Path(one.path) for one in opened if own in one.by and not any(by.endswith(_FRAMES) for by in one.by)]
        return _others(ours, [*method.files()])
    return []


def _others(paths: Iterable[Path], known: Iterable[Path]) -> list[Path]:
    """Return which of the paths are data files and not known, each once."""
    found = {path.resolve(): path for path in map(Path.expanduser, paths) if path.suffix not in ("", *_CODE)}
    brought = (*_SYSTEM, *(f"{folder}{os.sep}" for folder in {sys.prefix, sys.base_prefix}))
    without = {Path(path).expanduser().resolve() for path in known}
    return [
        path
        for whole, path in found.items()
        if whole not in without and not str(whole).startswith(brought) and whole.is_file()
    ]


def _texts(value: Any) -> Iterator[str]:
    """Yield the texts among arguments, however deep."""
    if isinstance(value, Mapping):
        for name, inner in value.items():
            yield from () if name == "_target_" else _texts(inner)
    elif isinstance(value, list | tuple):
        for inner in value:
            yield from _texts(inner)
    elif isinstance(value, str) and "\0" not in value and "\n" not in value:
        yield value


@cache
def _hear() -> None:
    """Let Python tell of every file that is opened from now on; nothing takes that back."""
    sys.addaudithook(_tell)


def _tell(event: str, arguments: tuple[Any, ...]) -> None:
    if not _listeners or event != "open":
        return
    path, mode, flags = arguments
    if (
        not isinstance(path, str | bytes | os.PathLike)
        or (mode is None and flags & _WRITES)
        or "r" not in (mode or "r")
    ):
        return
    by, frame = set[str](), sys._getframe(1)
    while frame is not None:
        by.add(frame.f_code.co_filename)
        frame = frame.f_back  # type: ignore[assignment]
    opened = Opened(os.fsdecode(path), frozenset(by))
    for heard in [*_listeners]:
        heard.append(opened)
