"""The paths of very many files in little memory, and their natural order."""

from __future__ import annotations

import os
import re
from array import array
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, overload

import numpy as np
import numpy.typing as npt
from natsort import natsort_keygen

_DIGITS = re.compile("0*([0-9]+)")


class Paths(Sequence[Path]):
    """File paths: each folder is held once, and of each file its name and the number of its folder.

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
        return paths if isinstance(paths, Paths) else cls._group_files((path.parent, path.name) for path in paths)

    @classmethod
    def below(cls, top: Path, texts: Sequence[str]) -> Paths:
        """Return the paths `top / text`."""
        known: dict[str, Path] = {}

        def split(text: str) -> tuple[Path, str]:
            folder, _, name = text.rpartition("/")
            if os.sep != "/" or not folder or name in ("", "."):
                return (top / text).parent, (top / text).name
            if folder not in known:
                known[folder] = top / folder
            return known[folder], name

        return cls._group_files(map(split, texts))

    @classmethod
    def joined(cls, parts: Iterable[Paths]) -> Paths:
        """Return the paths of all parts, one part after the other."""
        return cls._group_files(
            (part.folders[number], name)
            for part in parts
            for number, name in zip(part.numbers.tolist(), part.names, strict=True)
        )

    @classmethod
    def _group_files(cls, files: Iterable[tuple[Path, str]]) -> Paths:
        """Return paths by the folder and the name of each."""
        known: dict[Path, int] = {}
        numbers, names = array("i"), []
        for folder, name in files:
            numbers.append(known.setdefault(folder, len(known)))
            names.append(name)
        return cls([*known], np.array(numbers, np.int32), names)

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

    def distinct(self) -> Paths:
        """Return each different path once, in the order of the first."""
        files = zip(self.numbers.tolist(), self.names, strict=True)
        numbers, names = zip(*dict.fromkeys(files), strict=True) if len(self) else ((), ())
        return Paths(self.folders, np.array(numbers, np.int32), names)

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
