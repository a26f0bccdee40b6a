"""What leaves a mark on the disk if it is ever unpickled."""

from collections.abc import Callable
from pathlib import Path
from typing import Any


class Trap:
    """Unpickling it makes a file."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return Path.touch, (self.mark,)
