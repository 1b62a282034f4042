"""Arrays larger than memory: rows that are added to a file, and handled some at a time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus._files import writing

#: Rows that are handled at a time.
CHUNK = 1 << 18


class GrowingArray:
    """Rows that are added at the end, in a file: memory holds what is being worked on."""

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
        """All rows, as they are needed from the disk. Nothing can be added afterwards."""
        with writing(self._path):
            self._file.close()
        shape = (self.rows, self._columns) if self._columns else (self.rows,)
        # A file without bytes cannot be mapped.
        return np.memmap(self._path, self._kind, "r", shape=shape) if self.rows else np.empty(shape, self._kind)


def chunks(count: int) -> list[slice]:
    """Slices of so many rows, CHUNK at a time."""
    return [slice(start, min(start + CHUNK, count)) for start in range(0, count, CHUNK)]
