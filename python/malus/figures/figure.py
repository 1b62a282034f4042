"""One figure with its numbers, as picture, print and table."""

from __future__ import annotations

import io
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from malus.columns import csv_text
from malus.pictures import encode

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing


_SETTINGS = threading.Lock()


@dataclass(frozen=True)
class Figure:
    """One figure: picture, caption, and its numbers as a table."""

    name: str
    title: str
    caption: str
    picture: NDArray[np.uint8]
    header: Sequence[str]
    rows: Sequence[Sequence[Any]]
    #: The drawing from which the picture was made, kept for print only.
    drawing: Drawing | None = None
    #: Description of the picture for screen readers; "" = title and caption describe it.
    seen: str = ""

    @property
    def alt(self) -> str:
        """Text in place of the picture."""
        return f"{self.title}. {self.seen or self.caption}"

    def png(self) -> bytes:
        """Picture as PNG."""
        return encode(self.picture, "PNG", compress_level=4)

    def webp(self) -> bytes:
        """Picture as WebP, a fifth of the size, for the page."""
        return encode(self.picture, "WEBP", quality=86, method=2)

    def vector(self, kind: str) -> bytes:
        """The drawing as "svg" or "pdf", for print; the same bytes for the same data."""
        from matplotlib import rc_context

        if self.drawing is None:
            raise ValueError(f"{self.name} was not drawn for print, expected Plates(…, for_print=True)")
        buffer = io.BytesIO()
        undated = {"Date": None} if kind == "svg" else {"CreationDate": None}
        # matplotlib's settings are those of the whole process: two threads would set and restore each other's.
        with _SETTINGS, rc_context({"svg.hashsalt": self.name, "svg.fonttype": "none", "pdf.fonttype": 42}):
            self.drawing.savefig(buffer, format=kind, metadata=undated)
        return buffer.getvalue()

    def csv(self) -> str:
        """Numbers as CSV; missing numbers are empty."""
        return csv_text(self.header, self.rows)
