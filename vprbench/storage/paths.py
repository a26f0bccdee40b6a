"""The paths of very many files in little memory, and their natural order."""

from __future__ import annotations

import os
from array import array
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any, overload

import numpy as np
import numpy.typing as npt
from natsort import natsort_keygen


class Paths(Sequence[Path]):
    """File paths: each folder is held once, and of each file its name and the number of its folder.

    An integer index gives a path, a slice or an index array gives paths.
    """

    def __init__(self, files: Iterable[tuple[Path, str]]) -> None:
        """Take the folder and the name of each file."""
        known: dict[Path, int] = {}
        numbers, names = array("i"), []
        for folder, name in files:
            numbers.append(known.setdefault(folder, len(known)))
            names.append(name)
        self.folders = tuple(known)
        self.numbers = np.array(numbers, np.int32)  # (n,), of the folder of each file
        self.names = tuple(names)

    @classmethod
    def of(cls, paths: Iterable[Path]) -> Paths:
        """Return these paths, in their order."""
        return paths if isinstance(paths, Paths) else cls((path.parent, path.name) for path in paths)

    @classmethod
    def below(cls, top: Path, texts: Sequence[str]) -> Paths:
        """Return the paths `top / text`."""
        find_folder = cache(top.joinpath)
        split = (os.path.split(text) for text in texts)
        return cls((find_folder(folder), name) for folder, name in split)

    @classmethod
    def joined(cls, parts: Iterable[Paths]) -> Paths:
        """Return the paths of all parts, one part after the other."""
        return cls(file for part in parts for file in part._list_files(slice(None)))

    def __len__(self) -> int:
        """Return the number of paths."""
        return len(self.names)

    @overload
    def __getitem__(self, index: int) -> Path: ...
    @overload
    def __getitem__(self, index: slice | npt.NDArray[Any]) -> Paths: ...
    def __getitem__(self, index: int | slice | npt.NDArray[Any]) -> Path | Paths:
        """Return one path, or several."""
        if isinstance(index, int | np.integer):
            return self.folders[int(self.numbers[index])] / self.names[index]
        return Paths(self._list_files(index))

    def _list_files(self, index: slice | npt.NDArray[Any]) -> Iterator[tuple[Path, str]]:
        folders = (self.folders[number] for number in self.numbers[index].tolist())
        return zip(folders, choose_names(self.names, index), strict=True)

    def distinct(self) -> Paths:
        """Return each different path once, in the order of the first."""
        return Paths(dict.fromkeys(self._list_files(slice(None))))

    def in_folders(self) -> Iterator[tuple[Path, npt.NDArray[np.int64]]]:
        """Yield each folder and the positions of its files, ascending; folders in the order of their first files."""
        order = np.argsort(self.numbers, kind="stable")
        ends = np.cumsum(np.bincount(self.numbers))
        return zip(self.folders, np.split(order, ends[:-1]), strict=False)  # no file has no folder


def choose_names(names: Sequence[str], index: slice | npt.NDArray[Any]) -> tuple[str, ...]:
    """Return the names that a slice, an index array or an array of yes and no chooses."""
    if isinstance(index, slice):
        return tuple(names[index])
    return tuple(names[number] for number in np.arange(len(names))[index].tolist())


def natural_keys(texts: Sequence[str]) -> list[Any]:
    """Return for each text the key by which sorting puts 2.jpg before 10.jpg."""
    return list(map(natsort_keygen(), texts))
