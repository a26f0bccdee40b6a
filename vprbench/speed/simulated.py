"""Simulated descriptors of large maps: areas of similar places, one after the other, and noisy queries of them."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from vprbench import progress
from vprbench.errors import BadInput
from vprbench.storage.shards import Shards, Writer

AREA = 64  # consecutive places around one centre; shards hold whole areas
WITHIN = 0.5  # inner product of two places of one area, on average
SEEN_AGAIN = 0.8  # inner product of a query with its place, on average

Vectors = npt.NDArray[np.float32]  # (n, n_dimensions)


@dataclass(frozen=True)
class Simulated:
    """A map's descriptors of length 1, which lie below a folder; the same seed draws the same ones on any machine.

    A place is sqrt(WITHIN) times the centre of its area plus sqrt(1 - WITHIN) times a direction of its own; a query is
    SEEN_AGAIN times its place plus noise. All directions are uniform: no dimension says more than another.
    """

    above: Path
    n_places: int
    n_dimensions: int
    seed: int

    @property
    def folder(self) -> Path:
        """Where the descriptors lie."""
        return self.above / f"vprbench-map-{self.n_places}x{self.n_dimensions}-seed{self.seed}"

    @property
    def n_bytes(self) -> int:
        """The bytes that they take there."""
        return 4 * self.n_places * self.n_dimensions

    def written(self) -> Shards:
        """Write what does not lie there yet, and return all; raises BadInput where the disk has no room for it."""
        if (found := Shards.find(self.folder, self.n_places)) is not None:
            return found
        self.above.mkdir(parents=True, exist_ok=True)
        there = sum(path.stat().st_size for path in self.folder.glob("*.npy"))
        free = shutil.disk_usage(self.above).free + there
        if self.n_bytes > free:
            raise BadInput(
                f"{self.n_places:,} places of {self.n_dimensions} numbers take {self.n_bytes / 1e9:.1f} GB, "
                f"{free / 1e9:.1f} GB are free in {self.above}: give folder=, fewer places or fewer dimensions"
            )
        writer = Writer(self.folder, self.n_places, "simulated descriptors")
        for rows in writer.missing():
            progress.report(f"drawing {self.n_places:,} x {self.n_dimensions}", rows.start / self.n_places)
            writer.write(rows, [self._drawn(rows)])
        return writer.shards()

    def queries(self, n: int) -> Vectors:
        """Return `n` noisy copies of places that are evenly spread over the map, (n, n_dimensions)."""
        places = np.linspace(0, self.n_places - 1, n).astype(np.int64)
        noise = _directions(
            np.random.default_rng([self.seed, self.n_dimensions, self.n_places]), (n, self.n_dimensions)
        )
        return _unit(
            np.float32(SEEN_AGAIN) * self.written().take(places) + np.float32((1 - SEEN_AGAIN**2) ** 0.5) * noise
        )

    def remove(self) -> None:
        """Remove the descriptors."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def _drawn(self, rows: slice) -> Vectors:
        generator = np.random.default_rng([self.seed, self.n_dimensions, self.n_places, rows.start])
        n_areas = -(-(rows.stop - rows.start) // AREA)
        centres = _directions(generator, (n_areas, 1, self.n_dimensions))
        own = _directions(generator, (n_areas, AREA, self.n_dimensions))
        own *= np.float32((1 - WITHIN) ** 0.5)
        own += centres * np.float32(WITHIN**0.5)
        return _unit(own.reshape(-1, self.n_dimensions))[: rows.stop - rows.start]


def _directions(generator: np.random.Generator, shape: tuple[int, ...]) -> Vectors:
    return _unit(generator.standard_normal(shape, np.float32))


def _unit(vectors: Vectors) -> Vectors:
    vectors /= np.sqrt(np.einsum("...i,...i", vectors, vectors))[..., None]
    return vectors
