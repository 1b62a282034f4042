"""The picture that `malus check` writes: the coarse surface and the mask on the polarized image, before anything is computed."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus._files import write_bytes
from malus.figures.drawing import MOST_LETTERS, can_be_drawn, new_drawing
from malus.raster import reduced, step_for
from malus.station import Station

_LONG_SIDE_PX, _DPI, _PANEL_INCHES, _HEAD_INCHES, _MARGIN_INCHES = 1000, 130, 6.4, 0.35, 1.2
_OUTLINE = "#ff3fd0"
_CAPTION = (
    "First panel: the first polarized image. Second panel: the coarse surface's points where the camera of the station file sees them, "
    "colored by their distance. Edges and steps of the points should lie on those of the image, and the mask's outline on the object's."
)


def draw_overlay(
    image: NDArray[np.float32],
    mask: NDArray[np.uint8],
    points: NDArray[np.float32],
    name: str,
    unit: str,
    words: Sequence[str],
) -> bytes:
    """PNG with two panels: the image with the mask's outline, and the same with the points drawn on it.

    image: H×W, any linear scale; mask: H×W, non-zero = object; points: N×3, u, v [px] and distance z [unit]; words: sentences
    below the panels.
    """
    height, width = image.shape
    beside = height > 0.6 * width  # wide panels are stacked instead
    panel_width = _PANEL_INCHES if beside else 1.8 * _PANEL_INCHES
    panel_height = panel_width * height / width
    rows, columns = (1, 2) if beside else (2, 1)
    wide = columns * panel_width + _MARGIN_INCHES
    lines = [line for word in [*words, _CAPTION] for line in textwrap.wrap(word, int(11 * wide))]
    foot = 0.2 * len(lines) + 0.3
    high = rows * (panel_height + _HEAD_INCHES) + foot
    drawing = new_drawing(wide, high)
    panels = []
    # A name that is longer than the panel would be cut off at both ends.
    named = f"{name}: " if len(name) <= MOST_LETTERS and can_be_drawn(name) else ""
    for number, title in enumerate((f"{named}image and mask", "the coarse surface's points on it")):
        left = 0.1 + number * (panel_width + 0.1) * beside
        bottom = foot + (1 - number) * (panel_height + _HEAD_INCHES) * (not beside)
        panels.append(drawing.add_axes((left / wide, bottom / high, panel_width / wide, panel_height / high)))
        panels[-1].set_title(title, fontsize=9, parse_math=False)  # a name may have two $
        _show_image(panels[-1], image, mask)
    if len(points):
        shown = _show_points(panels[1], points, image.shape)
        bar = drawing.add_axes(((wide - 0.85) / wide, foot / high, 0.15 / wide, panel_height / high))
        drawing.colorbar(shown, cax=bar).set_label(f"distance from the camera [{unit}]", fontsize=8)
        bar.tick_params(labelsize=7)
    drawing.text(
        0.1 / wide, (foot - 0.15) / high, "\n".join(lines), fontsize=8, va="top", linespacing=1.4, parse_math=False
    )
    buffer = io.BytesIO()
    drawing.savefig(buffer, format="png", dpi=_DPI)
    return buffer.getvalue()


def _show_image(axes: Any, image: NDArray[np.float32], mask: NDArray[np.uint8]) -> None:
    from matplotlib import patheffects

    height, width = image.shape
    step = step_for(image.shape, _LONG_SIDE_PX)
    small = reduced(image, step)
    low, high = np.percentile(image[mask != 0], (0.5, 99.5)) if mask.any() else (image.min(), image.max())
    gray = np.clip((small - low) / max(float(high - low), 1e-12), 0, 1) ** (1 / 2.2)
    extent = (-0.5, width - 0.5, height - 0.5, -0.5)
    axes.imshow(gray, cmap="gray", vmin=0, vmax=1, extent=extent)
    object_share = reduced(np.where(mask != 0, np.float32(1), np.float32(0)), step)
    if 0 < object_share.min() + object_share.max() < 2:
        rows, columns = (np.linspace(step / 2 - 0.5, side * step - step / 2 - 0.5, side) for side in object_share.shape)
        outline = axes.contour(columns, rows, object_share, levels=[0.5], colors=_OUTLINE, linewidths=1.4)
        outline.set_path_effects([patheffects.withStroke(linewidth=2.6, foreground="black")])
    axes.set_xticks([])
    axes.set_yticks([])


def nearest_points(points: NDArray[np.float32], shape: tuple[int, ...]) -> tuple[NDArray[np.float32], float]:
    """The distance of the nearest point in each cell of the image (NaN = none), and the side of a cell in pixels. Cells are so
    large that most cells of a dense cloud have a point.

    points: N×3, u, v [px] and distance; shape: of the image.
    """
    height, width = shape
    cell = max(1.0, max(shape) / _LONG_SIDE_PX, 1.3 * (height * width / len(points)) ** 0.5)
    nearest = np.full((int(height / cell) + 1, int(width / cell) + 1), np.inf, np.float32)
    row, column = (np.maximum((points[:, k] + 0.5) / cell, 0).astype(int) for k in (1, 0))
    np.minimum.at(
        nearest, (np.minimum(row, nearest.shape[0] - 1), np.minimum(column, nearest.shape[1] - 1)), points[:, 2]
    )
    return np.where(np.isfinite(nearest), nearest, np.float32(np.nan)), cell


def _show_points(axes: Any, points: NDArray[np.float32], shape: tuple[int, ...]) -> Any:
    """Draw the nearest point in each cell of the image."""
    height, width = shape
    nearest, cell = nearest_points(points, shape)
    near, far = np.nanpercentile(nearest, (1, 99))
    extent = (-0.5, nearest.shape[1] * cell - 0.5, nearest.shape[0] * cell - 0.5, -0.5)
    distances = np.ma.masked_invalid(nearest)
    colored = axes.imshow(
        distances, cmap="turbo_r", vmin=near, vmax=max(far, near * (1 + 1e-6)), alpha=0.55, extent=extent
    )
    axes.set_xlim(-0.5, width - 0.5)
    axes.set_ylim(height - 0.5, -0.5)
    return colored


def write_overlay(
    path: Path,
    picture: tuple[NDArray[np.float32], NDArray[np.uint8], NDArray[np.float32]],
    station: Station,
    words: Sequence[str],
) -> None:
    """Write the picture of a station (image, mask, points) as a PNG file, with `words` below it."""
    sentences = [f"{text[0].upper()}{text[1:]}" for text in words]
    write_bytes(path, draw_overlay(*picture, station.name, station.unit, sentences))
