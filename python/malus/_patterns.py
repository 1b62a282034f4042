"""Patterns of file names, matched against a bounded number of names."""

from __future__ import annotations

import glob
import os
from collections.abc import Iterator
from fnmatch import fnmatchcase
from pathlib import Path

from malus.errors import InputError

#: A pattern that looks at more names than this probably searches the whole disk. The C++ library has the same bound.
MOST_NAMES = 100_000


def matching(folder: Path, pattern: str, where: str) -> list[Path]:
    """The paths that match a pattern relative to a folder. ** stands for any number of folders, including none. Hidden names match
    only a pattern that begins with a dot.

    InputError if too many names have to be looked at; its message begins with `where`, the place of the pattern in its file.
    """
    found = [folder]
    names = _counted(where)
    for part in Path(pattern).parts:
        found = list(dict.fromkeys(path for place in found for path in _step(place, part, names)))
    # os.path, unlike Path, answers "no" for names that are too long and for folders that may not be read.
    return [path for path in found if os.path.exists(path)]


def _counted(where: str) -> Iterator[None]:
    """An iterator to advance once for each name looked at; InputError after MOST_NAMES."""
    yield from [None] * MOST_NAMES
    raise InputError(f"{where}: more than {MOST_NAMES} names to look at, expected a pattern for a few folders")


def _step(place: Path, part: str, names: Iterator[None]) -> Iterator[Path]:
    """The paths that one part of a pattern matches below a place."""
    if part == "**":
        yield place
        left = [place]
        while left:
            inside = list(_entries(left.pop(), part, names))
            yield from inside
            left += [path for path in inside if os.path.isdir(path)]
    elif glob.has_magic(part):
        yield from (path for path in _entries(place, part, names) if fnmatchcase(path.name, part))
    else:
        next(names)
        yield place / part


def _entries(folder: Path, part: str, names: Iterator[None]) -> Iterator[Path]:
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                next(names)
                if part.startswith(".") or not entry.name.startswith("."):
                    yield Path(entry.path)
    except OSError:
        return  # not a folder, or no permission to read it
