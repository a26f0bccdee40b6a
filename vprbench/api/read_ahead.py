"""How far images are read ahead of whoever looks at them: bounded in number and in bytes, counted image by image."""

from __future__ import annotations

from collections.abc import Callable

CHUNK = 4  # images a reading thread takes at a time, at most
_AHEAD = 128  # images under way, at most
_BYTES = 1 << 26  # that these have, at most ...
_FEWEST = 4  # ... unless so few of them have more ...
_MOST_BYTES = 1 << 28  # ... and these at most, unless a single one has


class Window:
    """The images that were asked for and not yet handed out."""

    def __init__(self, n_images: int, n_bytes: Callable[[int], int] | None, readers: int) -> None:
        """Begin before the first of `n_images`; `n_bytes(i)`, asked in order, is what image i takes once decoded.

        If nobody knows that beforehand, the largest so far stands for the next ones, and of the first as many are
        asked for as keep so many readers busy.
        """
        self._n_images, self._readers = n_images, readers
        self._largest = 0
        self._n_bytes = n_bytes or (lambda _: self._largest or _BYTES // (2 * CHUNK * readers))
        self._next = 0
        self._under_way: dict[int, int] = {}  # the bytes of each
        self._waiting: int | None = None  # the bytes of the next one, where it had no room

    def take(self) -> range:
        """Return the images that are to be read next, none if all are under way or there is no room."""
        start, size = self._next, CHUNK
        while self._next < min(self._n_images, start + size):
            n_bytes = self._n_bytes(self._next) if self._waiting is None else self._waiting
            if not self._has_room(n_bytes):
                self._waiting = n_bytes
                break
            self._under_way[self._next], self._waiting = n_bytes, None
            self._next += 1
            size = min(size, max(1, min(_AHEAD, _BYTES // max(1, n_bytes)) // (2 * self._readers)))
        return range(start, self._next)

    def give(self, images: range, largest: int) -> None:
        """Take note that images were handed out, the largest of so many bytes."""
        self._largest = max(self._largest, largest)
        for number in images:
            del self._under_way[number]

    def _has_room(self, n_bytes: int) -> bool:
        count, total = len(self._under_way) + 1, sum(self._under_way.values()) + n_bytes
        return count == 1 or (count <= _AHEAD and total <= _BYTES) or (count <= _FEWEST and total <= _MOST_BYTES)
