"""The paths of very many files in little memory, and their natural order."""

from __future__ import annotations

import os
import re
import sys
from array import array
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, pairwise
from pathlib import Path
from typing import Any, overload

import numpy as np
import numpy.typing as npt
from natsort import natsort_keygen

_DIGITS = re.compile("0*([0-9]+)")
_FILE_SYSTEM = sys.getfilesystemencoding(), sys.getfilesystemencodeerrors()


class Paths(Sequence[Path]):
    """File paths, of which every folder is held once, and of each file its name and the number of its folder.

    An integer index gives a path, a slice or an index array gives paths.
    """

    def __init__(self, folders: Sequence[Path], numbers: npt.NDArray[np.int32], names: Sequence[str]) -> None:
        """Take different folders, and of each file the number of its folder, (n,), and its name."""
        self.folders = tuple(folders)
        self.numbers = numbers
        self.names = tuple(names)

    @classmethod
    def of(cls, paths: Iterable[Path]) -> Paths:
        """Return these paths, in their order."""
        if isinstance(paths, Paths):
            return paths
        paths = list(paths)
        return cls.grouped([path.parent for path in paths], [path.name for path in paths])

    @classmethod
    def grouped(cls, parents: Sequence[Path], names: Sequence[str]) -> Paths:
        """Return paths by the folder and the name of each."""
        known: dict[Path, int] = {}
        numbers = np.fromiter((known.setdefault(parent, len(known)) for parent in parents), np.int32, len(names))
        return cls([*known], numbers, names)

    @classmethod
    def below(cls, top: Path, texts: Sequence[str]) -> Paths:
        """Return the paths `top / text`."""
        folders: dict[Path, int] = {}
        known: dict[str, int] = {}  # by their texts
        numbers, names = array("i"), []
        for text in texts:
            folder, _, name = text.rpartition("/")
            number = known.get(folder)
            if number is None or name in ("", "."):
                whole = top / text
                number, name = folders.setdefault(whole.parent, len(folders)), whole.name
                if folder and os.sep == "/" and text.endswith(f"/{name}"):
                    known[folder] = number
            numbers.append(number)
            names.append(name)
        return cls([*folders], np.array(numbers, np.int32), names)

    @classmethod
    def joined(cls, parts: Iterable[Paths]) -> Paths:
        """Return the paths of all parts, one part after the other."""
        parts = list(parts)
        known: dict[Path, int] = {}
        places = [
            np.array([known.setdefault(folder, len(known)) for folder in part.folders], np.int32) for part in parts
        ]
        numbers = [place[part.numbers] for place, part in zip(places, parts, strict=True)]
        names = tuple(chain.from_iterable(part.names for part in parts))
        return cls([*known], np.concatenate([np.empty(0, np.int32), *numbers]), names)

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
        return Paths(self.folders, self.numbers[index], chosen_names(self.names, index))

    def absolute(self) -> Paths:
        """Return the same paths from the root of the file system."""
        return Paths.joined([Paths([folder.absolute() for folder in self.folders], self.numbers, self.names)])

    def encoded(self, positions: npt.NDArray[np.int64]) -> list[bytes]:
        """Return some of the paths as the file system is told them."""
        prefixes = {
            number: os.fsencode(self.folders[number] / "_")[:-1] for number in set(self.numbers[positions].tolist())
        }
        which = zip(self.numbers[positions].tolist(), positions.tolist(), strict=True)
        return [prefixes[number] + self.names[at].encode(*_FILE_SYSTEM) for number, at in which]

    def distinct(self) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
        """Return the positions of all different paths, sorted by folder and name, and where among them each path is."""
        name = self.names.__getitem__
        groups = sorted(self.in_folders(), key=lambda group: group[0])
        order = np.fromiter(chain.from_iterable(sorted(group.tolist(), key=name) for _, group in groups), np.int64)
        differs = np.fromiter((name(one) != name(next) for one, next in pairwise(order.tolist())), bool)
        is_first = np.append(True, differs | (np.diff(self.numbers[order]) != 0))[: len(self)]
        which = np.empty(len(self), np.int64)
        which[order] = np.cumsum(is_first) - 1
        return order[is_first], which

    def in_folders(self) -> Iterator[tuple[Path, npt.NDArray[np.int64]]]:
        """Yield each folder that holds any of the files, and their positions, ascending; in order of the first."""
        order = np.argsort(self.numbers, kind="stable")
        ends = np.flatnonzero(np.diff(self.numbers[order])) + 1
        for group in sorted(filter(len, np.split(order, ends)), key=lambda group: int(group[0])):
            yield self.folders[self.numbers[group[0]]], group


def chosen_names(names: Sequence[str], index: slice | npt.NDArray[Any]) -> tuple[str, ...]:
    """Return the names that a slice, an index array or an array of yes and no chooses."""
    if isinstance(index, slice):
        return tuple(names[index])
    return tuple(names[number] for number in np.arange(len(names))[index].tolist())


def natural_keys(texts: Sequence[str]) -> list[Any]:
    """Return for each text the key by which sorting puts 2.jpg before 10.jpg, as natsort does; one call's keys compare.

    Keys of printable ASCII are text: each number stands without leading zeros, after a 0 and the count of its digits.
    """
    if not all(text.isascii() and text.isprintable() for text in texts):
        key = natsort_keygen()
        return [key(text) for text in texts]
    return [_DIGITS.sub(lambda found: f"\0{chr(len(found[1]))}{found[1]}", text) for text in texts]
