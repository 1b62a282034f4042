"""All plates of a workspace on one page, for an overview."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

#: Plates per row; pixels of a plate's longer side, of the space around it, and of the letters of its name.
_COLUMNS, _SIDE, _GAP, _LETTERS = 5, 480, 16, 22


def contact_sheet(plates: Sequence[tuple[str, NDArray[np.uint8]]]) -> NDArray[np.uint8]:
    """Pictures (H×W×3) in rows below their names, reduced to fit a square, as one picture (H×W×3); a row is as high as its highest picture."""
    pictures = []
    for _, picture in plates:
        small = Image.fromarray(picture)
        small.thumbnail((_SIDE, _SIDE))
        pictures.append(small)
    starts = range(0, len(plates), _COLUMNS)
    name_height = int(1.5 * _LETTERS)
    heights = [name_height + _GAP + max(p.height for p in pictures[at : at + _COLUMNS]) for at in starts]
    sheet = Image.new("RGB", (_COLUMNS * (_SIDE + _GAP) + _GAP, sum(heights) + _GAP), "white")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(_LETTERS)
    for number, (name, _) in enumerate(plates):
        left = _GAP + number % _COLUMNS * (_SIDE + _GAP)
        top = _GAP + sum(heights[: number // _COLUMNS])
        draw.text((left, top), name, fill="black", font=font)
        sheet.paste(pictures[number], (left, top + name_height))
    return np.asarray(sheet)
