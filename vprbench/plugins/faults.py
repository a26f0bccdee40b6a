"""What a plug-in did wrong, in one line that names its file and line."""

from __future__ import annotations

import traceback
from pathlib import Path

_OURS = str(Path(__file__).parents[1])
_BETWEEN = ("importlib", "hydra", "<frozen")  # between us and the plug-in


def describe_error(error: BaseException, file: str | None = None) -> str:
    """Return an error in one line, with the place that raised it: the innermost in `file`, else in any plug-in."""
    if isinstance(error, SyntaxError):
        return f"SyntaxError: {error.msg}{_place(error.filename, error.lineno)}"
    text = (str(error).splitlines() or [""])[0]
    if not isinstance(error, ImportError) or not text:
        text = ": ".join(filter(None, [type(error).__name__, text]))
    frames = traceback.extract_tb(error.__traceback__)
    there = [frame for frame in frames if (frame.filename == file if file else _of_a_plug_in(frame.filename))]
    return text + (_place(there[-1].filename, there[-1].lineno) if there else "")


def _of_a_plug_in(file: str) -> bool:
    return not file.startswith(_OURS) and not any(part in file for part in _BETWEEN)


def _place(file: str | None, line: int | None) -> str:
    if file is None:
        return ""
    path = Path(file)
    return f" ({path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path}, line {line})"
