"""Line drawings of a surface: contour lines and sections, as DXF for CAD and drawing offices and as SVG for print.

Contours lie in the plane of the elevation model. Sections lie in a plane of their own: distance along the profile and height above
its chord. Both are at scale 1:1 in the station's unit; an SVG states its size in millimeters.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray

from malus._extra import extra
from malus._files import replacing, write_text
from malus.columns import number
from malus.errors import DataError, InputError
from malus.lengths import round_below
from malus.surface import Dem
from malus.units import METERS

Line = NDArray[np.float64]
#: Drawing units of DXF ($INSUNITS).
_DXF_UNITS = {"um": 13, "mm": 4, "cm": 5, "m": 6, "in": 1, "ft": 2}


@dataclass
class Layer:
    """Lines (each N×2 or N×3, station unit) under one name: a layer of a DXF drawing, a group of an SVG drawing, whose title is `label`."""

    name: str
    lines: list[Line] = field(default_factory=list)
    label: str = ""


def contours(dem: Dem, interval: float | None = None) -> list[Layer]:
    """Contour lines of an elevation model, one layer per height; lines are N×3: x right, y up, elevation.

    interval: station unit; by default a round number that gives 10 to 25 lines on the relief without its highest and lowest thousandth,
    which may be wrong points. The lines go up to the highest point. Where the default interval would then give more than 1000, they leave
    out those highest and lowest thousandths. InputError if an interval gives more than 1000 lines.
    """
    import contourpy

    known = dem.elevation[np.isfinite(dem.elevation)]
    if known.size == 0 or not np.ptp(known) > 0:
        raise DataError("contours: the elevation model has no relief")
    bottom, low, high, top = (float(x) for x in np.percentile(known, [0, 0.1, 99.9, 100]))
    step = round_below((high - low or top - bottom) / 10) if interval is None else interval
    if not (step > 0 and math.isfinite(step)):
        raise InputError(f"--interval {step}, expected a positive length")
    first, last = math.ceil(bottom / step), math.floor(top / step)
    if interval is None and last - first > 1000:
        first, last = math.ceil(low / step), math.floor(high / step)
    if last - first > 1000:
        raise InputError(
            f"--interval {step} gives {last - first} contour lines, expected at most 1000; the relief spans {number(top - bottom, 4)}"
        )
    rows, columns = dem.elevation.shape
    masked = np.ma.masked_invalid(dem.elevation)
    generator = contourpy.contour_generator(
        np.arange(columns) * dem.pixel, -np.arange(rows) * dem.pixel, masked, line_type=contourpy.LineType.Separate
    )
    layers = []
    for k in range(first, last + 1):
        height = k * step
        drawn = [np.asarray(line, dtype=np.float64) for line in generator.lines(height)]
        lines = [np.column_stack([line, np.full(len(line), height)]) for line in drawn]
        layers.append(Layer(f"{height:.6g}", [line for line in lines if len(line) > 1], f"{height:.6g}"))
    return layers


def section(position: Sequence[float | None], height: Sequence[float | None]) -> list[Line]:
    """The lines (N×2: position along the profile, height) of a profile from quality.json; a gap (None) ends a line."""
    points = np.array([position, height], dtype=float).T
    known = np.isfinite(points).all(1)
    breaks = np.flatnonzero(np.diff(known.astype(int))) + 1
    pieces = np.split(np.arange(len(points)), breaks)
    return [points[piece] for piece in pieces if known[piece[0]] and len(piece) > 1]


def set_apart(groups: Sequence[Sequence[Layer]]) -> None:
    """Move every group of layers below the group before it, so that sections do not lie over each other."""
    top = 0.0
    for layers in groups:
        group = [line for layer in layers for line in layer.lines]
        if not group:
            continue
        heights = np.concatenate([line[:, 1] for line in group])
        shift = top - float(heights.max())
        for line in group:
            line[:, 1] += shift
        top = float(heights.min()) + shift - 0.25 * max(float(np.ptp(heights)), 1e-9)


def write_dxf(path: Path, layers: list[Layer], unit: str, words: Mapping[str, str]) -> None:
    """Write layers as polylines of a DXF drawing (R2010), station unit; `words` become custom properties of the drawing."""
    if not any(layer.lines for layer in layers):
        raise DataError(f"{path}: there is nothing to draw")
    ezdxf = extra("ezdxf", "ezdxf", f"{path}: DXF")
    document = ezdxf.new("R2010", setup=False)
    document.header["$INSUNITS"] = _DXF_UNITS[unit]
    document.header["$MEASUREMENT"] = 0 if unit in ("in", "ft") else 1
    for name, value in words.items():
        document.header.custom_vars.append(name, value)
    space = document.modelspace()
    for layer in layers:
        name = "".join("_" if c in '<>/\\":;?*|=`,' else c for c in layer.name)
        if name not in document.layers:
            document.layers.add(name)
        for line in layer.lines:
            if line.shape[1] == 3:
                space.add_polyline3d(line.tolist(), dxfattribs={"layer": name})
            else:
                space.add_lwpolyline(line.tolist(), dxfattribs={"layer": name})
    with replacing(path) as temporary:
        document.saveas(temporary)


def write_svg(path: Path, layers: list[Layer], unit: str, title: str, description: str) -> None:
    """Write layers as paths of an SVG drawing at scale 1:1, y up as in the plane. `description`: text that programs show for it."""
    points = [line[:, :2] for layer in layers for line in layer.lines]
    if not points:
        raise DataError(f"{path}: there is nothing to draw")
    every = np.concatenate(points)
    low, size = every.min(0), np.ptp(every, axis=0)
    margin = max(0.05 * float(size.max()), 1e-9)
    width, height = size + 2 * margin
    scale = METERS[unit] * 1000  # millimeters
    line_width = float(size.max()) / 1500

    def path_of(line: Line) -> str:
        x = line[:, 0] - low[0] + margin
        y = height - (line[:, 1] - low[1] + margin)
        return "M" + "L".join(f"{a:.6g},{b:.6g}" for a, b in zip(x, y, strict=True))

    body = []
    for layer in layers:
        drawn = "".join(f'<path d="{path_of(line)}"/>' for line in layer.lines)
        body.append(
            f'<g id="{escape(layer.name, {chr(34): "&quot;"})}"><title>{escape(layer.label)}</title>{drawn}</g>'
        )
    write_text(
        path,
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width * scale:.6g}mm" height="{height * scale:.6g}mm" '
        f'viewBox="0 0 {width:.6g} {height:.6g}">\n<title>{escape(title)}</title>\n'
        f"<desc>{escape(description)}</desc>\n"
        f'<g fill="none" stroke="black" stroke-width="{line_width:.4g}" stroke-linejoin="round">\n'
        + "\n".join(body)
        + "\n</g>\n</svg>\n",
    )
