"""What the figures of one workspace are drawn from and on: its rasters at the pictures' size, maps and images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from malus.columns import number as readable
from malus.figures.drawing import BAR_IN, LETTERS_PT, color_bar, drawn, outline, over_bar
from malus.figures.figure import Figure
from malus.lengths import scale_bar
from malus.raster import reduced, step_for
from malus.relief import flattened, hillshade
from malus.workspace import Raster, Workspace

# matplotlib is imported only when something is drawn: importing it takes as long as the rest of a program's start.
if TYPE_CHECKING:
    from matplotlib.colors import Colormap
    from matplotlib.figure import Figure as Drawing


#: Long side of the pictures' data in pixels: larger rasters are averaged down, because a report needs no more.
MAX_SIDE_PX = 1600
#: Colors of the three surfaces in every plot.
COLORS = {"prior": "#b0702a", "polarization": "#2f7fb3", "fused": "#1d2733"}
#: Names of the surfaces in figures, unless the paper's names are requested.
OWN_WORDS = {name: name for name in COLORS}
#: Percentiles of a map's values in its CSV file.
_PERCENTILES = (0, 1, 5, 25, 50, 75, 95, 99, 100)
#: Largest opacity of relief shading over the colors of a map.
_SHADE_OPACITY = 0.8


def _with_shares(
    ticks: Mapping[float, str], values: NDArray[np.float64], borders: NDArray[np.float64]
) -> dict[float, str]:
    """Names of a map's classes with the share of pixels in each, because a class of few pixels cannot be seen in the picture."""
    shares = np.histogram(values, borders)[0] / max(1, values.size)
    named = {}
    for (at, name), share in zip(ticks.items(), shares, strict=True):
        percent = "< 0.1" if 0 < share < 0.001 else "> 99.9" if 0.999 < share < 1 else f"{100 * share:.3g}"
        named[at] = f"{name} {percent} %"
    return named


def _spread(values: NDArray[Any], label: str) -> str:
    """A sentence on the range of most values of a map; "" for pictures without a unit."""
    if not label or not values.size:
        return ""
    low, middle, high = (readable(float(p)) for p in np.percentile(values, (5, 50, 95)))
    return f" Nine tenths of the values lie between {low} and {high} {label}, half of them below {middle} {label}."


class Plates:
    """Draws the figures of one workspace."""

    def __init__(self, workspace: Workspace, *, for_print: bool = False, words: Mapping[str, str] = OWN_WORDS) -> None:
        """for_print: figures keep their drawings, so that they can be written as SVG and PDF, too. words: names of the surfaces in
        figures, by their names in quality.json.
        """
        self.workspace = workspace
        self.words = words
        self.for_print = for_print
        self.quality = workspace.quality
        self.unit = str(self.quality["unit"])
        self.gsd = float(self.quality["gsd"])
        camera = workspace.camera
        self.step = step_for((camera.height, camera.width), MAX_SIDE_PX)

    def raster(self, name: str) -> Raster:
        """A raster of the workspace at the size of the pictures."""
        return self.small(self.workspace.raster(name))

    def small(self, raster: Raster) -> Raster:
        """A raster at the size of the pictures."""
        return reduced(raster, self.step)

    def thinned(self, name: str) -> Raster:
        """A raster of the workspace at the size of the pictures, subsampled instead of averaged: for angles and labels."""
        return self.workspace.raster(name)[:: self.step, :: self.step]

    @cached_property
    def relief(self) -> dict[str, Raster]:
        """Relief of prior and fused surface in the station's unit."""
        return {name: flattened(self.raster(f"{name}/depth.tif")) for name in ("prior", "fused")}

    def shade(self, surface: str, azimuth_deg: float = 315) -> Raster:
        """Relief shading of a surface."""
        return hillshade(self.relief[surface], self.gsd * self.step, azimuth_deg)

    def object_box(self) -> tuple[slice, slice]:
        """Rows and columns of the pictures that contain the object, with a small margin."""
        known = np.isfinite(self.relief["fused"])
        rows, columns = np.nonzero(known.any(1))[0], np.nonzero(known.any(0))[0]
        margin = max(4, max(known.shape) // 60)
        return (
            slice(max(0, rows[0] - margin), rows[-1] + 1 + margin),
            slice(max(0, columns[0] - margin), columns[-1] + 1 + margin),
        )

    def figure(
        self,
        name: str,
        title: str,
        caption: str,
        drawing: Drawing,
        header: Sequence[str],
        rows: Sequence[Sequence[Any]],
        seen: str = "",
    ) -> Figure:
        """A figure of a drawing; `seen`: description for screen readers."""
        return Figure(name, title, caption, drawn(drawing), header, rows, drawing if self.for_print else None, seen)

    def signed_map(
        self,
        name: str,
        title: str,
        caption: str,
        raster: Raster,
        unit: str,
        *,
        shade: Raster | None = None,
        labels: Sequence[tuple[float, float, str]] = (),
    ) -> Figure:
        """Map of signed distances (at the size of the pictures), blue for positive ones, over relief shading if it is given.

        labels: column and row in the raster, and what is written there.
        """
        finite = np.abs(raster[np.isfinite(raster)])
        spread = (float(np.percentile(finite, 95)) if finite.size else 0.0) or 1.0
        return self.map(
            name, title, caption, raster, "RdBu", unit, limits=(-spread, spread), shade=shade, labels=labels
        )

    def map(
        self,
        name: str,
        title: str,
        caption: str,
        raster: Raster,
        cmap: str | Colormap,
        unit: str = "",
        *,
        limits: tuple[float, float] | None = None,
        ticks: Mapping[float, str] | None = None,
        shade: Raster | None = None,
        labels: Sequence[tuple[float, float, str]] = (),
    ) -> Figure:
        """Map of a raster at the size of the pictures, with its color bar if it has a unit or `ticks`, and a scale bar."""
        finite = raster[np.isfinite(raster)].astype(float)
        if limits is None:
            limits = tuple(np.percentile(finite, [1, 99])) if finite.size else (0.0, 1.0)
        shape = raster.shape
        drawing, axes = over_bar(shape, BAR_IN if unit or ticks else 0.0)
        picture = axes.imshow(raster, cmap=cmap, vmin=limits[0], vmax=limits[1], interpolation="antialiased")
        if shade is not None:
            # Black of varying opacity over the colors shows detail that is far too small for differences in color.
            axes.imshow(
                np.dstack([np.zeros((*shade.shape, 3)), _SHADE_OPACITY * (1 - np.nan_to_num(shade, nan=1))]),
                interpolation="antialiased",
            )
        axes.set_axis_off()
        self._scale_bar(axes, shape[1])
        for u, v, word in labels:
            text = axes.text(u, v, word, color="white", fontsize=LETTERS_PT, ha="center", va="center")
            text.set_path_effects(outline("black"))
        if ticks and not isinstance(cmap, str):
            ticks = _with_shares(ticks, finite, np.linspace(*limits, cmap.N + 1))
        if unit or ticks:
            color_bar(drawing, picture, unit, ticks)
        mean_and_percentiles = [finite.mean(), *np.percentile(finite, _PERCENTILES).tolist()] if finite.size else []
        summary = [title, unit, finite.size, *(mean_and_percentiles or [None] * (1 + len(_PERCENTILES)))]
        return self.figure(
            name,
            title,
            caption,
            drawing,
            ["map", "unit", "pixels", "mean", *(f"p{p:02d}" for p in _PERCENTILES)],
            [summary],
            caption + _spread(finite, unit),
        )

    def _scale_bar(self, axes: Any, width_px: int) -> None:
        """A length on the object, at the lower left of a picture of the rasters."""
        pixel = self.gsd * self.step
        length, label = scale_bar(width_px * pixel, self.unit)
        left, low = 0.03, 0.045
        for color, width in (("white", 4.5), ("black", 2.2)):
            axes.plot(
                [left, left + length / (width_px * pixel)], [low, low], color=color, lw=width, solid_capstyle="butt",
                transform=axes.transAxes, zorder=5,
            )  # fmt: skip
        text = axes.text(left, low + 0.015, label, color="black", fontsize=LETTERS_PT, transform=axes.transAxes)
        text.set_path_effects(outline("white"))

    def on_image(self, *, with_bar: bool = False) -> tuple[Drawing, Any]:
        """A drawing of the unpolarized image, and its axes in pixels of `raster`, to draw on it; with_bar: with space for a
        `color_bar` below."""
        intensity = self.raster("polarization/unpolarized.tif")
        drawing, axes = over_bar(intensity.shape, BAR_IN if with_bar else 0.0)
        low, high = np.nanpercentile(intensity, [1, 99])
        axes.imshow(intensity, cmap="gray", vmin=low, vmax=high)
        axes.set_axis_off()
        axes.set(xlim=(-0.5, intensity.shape[1] - 0.5), ylim=(intensity.shape[0] - 0.5, -0.5))
        self._scale_bar(axes, intensity.shape[1])
        return drawing, axes
