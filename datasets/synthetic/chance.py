"""Chance as a pure function: integer hashes and smooth integer noise, the same on every machine."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Ints = npt.NDArray[np.int64]

#: Smooth noise runs from 0 to FULL - 1.
FULL = 1024

_INDEX_FACTOR = np.uint64(0x9E3779B97F4A7C15)
_CHANNEL_FACTOR = np.uint64(0xD1B54A32D192ED03)
_FIRST_FACTOR = np.uint64(0xBF58476D1CE4E5B9)
_SECOND_FACTOR = np.uint64(0x94D049BB133111EB)
_S30, _S27, _S31, _S54 = (np.uint64(shift) for shift in (30, 27, 31, 54))


class Chance:
    """Random numbers that are looked up by (channel, index) instead of drawn one after the other."""

    def __init__(self, seed: int) -> None:
        """Mix the seed so that neighbouring seeds share nothing."""
        self._salt = np.random.PCG64(seed).random_raw(1).astype(np.uint64)  # (1,)

    def _hash(self, channel: npt.ArrayLike, index: Ints) -> npt.NDArray[np.uint64]:
        # splitmix64; unsigned arrays wrap around silently, which is what is wanted
        channels = np.asarray(channel, np.int64).astype(np.uint64)
        z = index.astype(np.uint64) * _INDEX_FACTOR + (channels * _CHANNEL_FACTOR + self._salt)
        z ^= z >> _S30
        z *= _FIRST_FACTOR
        z ^= z >> _S27
        z *= _SECOND_FACTOR
        z ^= z >> _S31
        return z

    def dice(self, channel: npt.ArrayLike, index: Ints) -> Ints:
        """Return eight independent bytes, 0 to 255, per index: (8, *index.shape)."""
        bytes_last = self._hash(channel, index).astype("<u8")[..., None].view(np.uint8)
        return np.moveaxis(bytes_last, -1, 0).astype(np.int64)

    def smooth(self, channel: npt.ArrayLike, position: Ints, wavelength: npt.ArrayLike) -> Ints:
        """Return smooth value noise, 0 to FULL - 1; the arguments broadcast.

        Every `wavelength` units of `position` there is a new value; in between it eases from one to the next.
        """
        wave = np.asarray(wavelength, np.int64)
        knot = position // wave
        t = ((position - knot * wave) << 8) // wave
        eased = (t * t * (768 - 2 * t)) >> 16  # 3t^2 - 2t^3 in 1/256
        ends = (self._hash(channel, np.stack([knot, knot + 1])) >> _S54).astype(np.int64)
        noise: Ints = ends[0] + (((ends[1] - ends[0]) * eased) >> 8)
        return noise
