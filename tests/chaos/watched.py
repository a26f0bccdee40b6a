"""Methods of the sweep that `make chaos` disturbs, which notice a second process that makes their own cell."""

import fcntl
import hashlib
import os
from pathlib import Path

from vprbench.methods import flyhash, hyperdimensional, random_projection

_locks = []  # held until the process ends, however it does


def _watch(method):
    if _locks or not (folder := os.environ.get("CHAOS_WATCH")):
        return
    options = {name: value for name, value in vars(method).items() if isinstance(value, str | int | float)}
    cell = f"{type(method).__name__} {sorted(options.items())}"
    _locks.append((Path(folder) / hashlib.sha256(cell.encode()).hexdigest()[:16]).open("a"))
    try:
        fcntl.flock(_locks[0], fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        with (Path(folder) / "doubled").open("a") as file:
            file.write(f"{cell}\n")


class _Watched:
    def fit(self, *given):
        _watch(self)
        return super().fit(*given)

    def match(self, *given):
        _watch(self)  # a map may come from a file
        return super().match(*given)


class RandomProjection(_Watched, random_projection.RandomProjection):
    """Random projections."""


class FlyHash(_Watched, flyhash.FlyHash):
    """Winners among random sums."""


class HyperDimensional(_Watched, hyperdimensional.HyperDimensional):
    """Hyperdimensional vectors."""
