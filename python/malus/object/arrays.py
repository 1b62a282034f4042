"""Arrays larger than memory: kept in files and handled in chunks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus._files import writing

#: Rows that are handled at a time.
CHUNK = 1 << 18


class GrowingArray:
    """An array whose rows are appended to a file; only rows in use are in memory."""

    def __init__(self, path: Path, kind: type[np.generic], columns: int = 0) -> None:
        self._path, self._kind, self._columns = path, np.dtype(kind), columns
        with writing(path):
            self._file = path.open("wb")
        self.rows = 0

    def add(self, values: NDArray[Any]) -> None:
        """Add rows."""
        with writing(self._path):
            self._file.write(np.ascontiguousarray(values, self._kind).data)
        self.rows += len(values)

    def array(self) -> NDArray[Any]:
        """All rows, mapped from the file. No rows can be added afterwards."""
        with writing(self._path):
            self._file.close()
        shape = (self.rows, self._columns) if self._columns else (self.rows,)
        # A file without bytes cannot be mapped.
        return np.memmap(self._path, self._kind, "r", shape=shape) if self.rows else np.empty(shape, self._kind)


def on_disk(values: NDArray[Any], path: Path) -> NDArray[Any]:
    """The same array, mapped from a new file, so that the system may drop its pages from memory."""
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        np.ascontiguousarray(values).tofile(path)
    return np.memmap(path, values.dtype, "r", shape=values.shape)


def chunks(count: int, width: int = 1) -> list[slice]:
    """Slices that divide `count` rows of `width` values, about CHUNK values each."""
    rows = max(1, CHUNK // width)
    return [slice(start, min(start + rows, count)) for start in range(0, count, rows)]
