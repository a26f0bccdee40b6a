"""Checks of methods' arguments."""

from __future__ import annotations

from vprbench.api import BadInput


def require_arguments(method: object, **wanted: tuple[bool, str]) -> None:
    """Raise BadInput for the first of a method's arguments that does not fit: whether it fits, and the wish."""
    for name, (fits, wish) in wanted.items():
        if not fits:
            raise BadInput(f"method.{name}={getattr(method, name)}: give {wish}")
