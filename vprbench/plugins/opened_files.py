"""Data files that the code of a method opens, beside those that its `files()` names."""

from __future__ import annotations

import inspect
import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from traceback import walk_stack
from typing import Any, NamedTuple

from vprbench.api.method import Method

_CODE = ("", ".py", ".pyc", ".nbi", ".nbc", ".so", ".pyd", ".dll")
_INSTALLED = ("/proc/", "/sys/", "/dev/", "/etc/", "/usr/", f"{sys.prefix}{os.sep}", f"{sys.base_prefix}{os.sep}")
_HARNESS = (str(Path("vprbench", "api", "images.py")), str(Path("vprbench", "storage", "hashes.py")))
_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT


class OpenedFile(NamedTuple):
    """A file that was opened to be read, and the source files of the functions that were running."""

    path: str
    callers: frozenset[str]


_recordings: dict[int, list[OpenedFile]] = {}  # of the blocks that run now


@contextmanager
def record_opened_files() -> Iterator[list[OpenedFile]]:
    """Collect the files that Python code opens to be read in the block; a library in C opens files unseen."""
    _add_hook()
    opened: list[OpenedFile] = []
    _recordings[id(opened)] = opened
    try:
        yield opened
    finally:
        del _recordings[id(opened)]


def list_data_files(method: Method, arguments: Mapping[str, Any], opened: Iterable[OpenedFile]) -> list[Path]:
    """Return `files()` of a method, then the files that its arguments name and those that it opened.

    Raises BadInput as `files()` does.
    """
    named = [*method.files()]
    others = [*map(Path, _list_texts(arguments)), *find_unnamed_files(opened, method)]
    return [*named, *_select_data_files(others, named)]


def find_unnamed_files(opened: Iterable[OpenedFile], method: Method) -> list[Path]:
    """Return the data files that the code of a method opened and its `files()` does not name, each once.

    Code, frames, hashes of files and installed files do not count. The list is empty for a class without a source file.
    """
    with suppress(TypeError, OSError):
        source = inspect.getfile(type(method))
        return _select_data_files((Path(file.path) for file in opened if source in file.callers), method.files())
    return []


def _select_data_files(paths: Iterable[Path], named: Iterable[Path]) -> list[Path]:
    found = [path.expanduser() for path in paths if path.suffix not in _CODE]
    resolved = {path.resolve(): path for path in found if os.path.isfile(path)}  # noqa: PTH113 (Path.is_file may raise)
    known = {Path(path).expanduser().resolve() for path in named}
    return [path for whole, path in resolved.items() if whole not in known and not str(whole).startswith(_INSTALLED)]


def _list_texts(value: Any) -> list[str]:
    """Return the texts among arguments, however deep."""
    if isinstance(value, str):
        return [value]
    if isinstance(value, Mapping):
        value = [inner for name, inner in value.items() if name != "_target_"]
    return [text for inner in value for text in _list_texts(inner)] if isinstance(value, list | tuple) else []


@cache
def _add_hook() -> None:
    sys.addaudithook(_record)  # Python cannot remove an audit hook


def _record(event: str, arguments: tuple[Any, ...]) -> None:
    if event != "open" or not _recordings:
        return
    path, _, flags = arguments
    if not isinstance(path, str | bytes | os.PathLike) or flags & _WRITES:
        return
    callers = frozenset(frame.f_code.co_filename for frame, _ in walk_stack(sys._getframe(1)))
    if not any(caller.endswith(_HARNESS) for caller in callers):
        for opened in [*_recordings.values()]:
            opened.append(OpenedFile(os.fsdecode(path), callers))
