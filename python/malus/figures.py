"""The report's figures, each drawn from a finished workspace, with the numbers behind it."""

from __future__ import annotations

import base64
import io
import threading
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from malus.columns import csv_text, printed
from malus.columns import number as readable
from malus.errors import ResourceError
from malus.lengths import scale_bar, shown
from malus.units import METERS
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
_DPI = 150
#: Width of a figure in inches, and size of its letters in points: on a telephone that shows the figure 356 pixels wide, letters
#: still have 11 pixels.
WIDTH_IN = 6.4
LETTERS_PT = 14.5
#: Inches below a picture for its color bar.
_BAR_IN = 0.66
#: Largest length of a histogram's axis, as a multiple of the range of the narrowest histogram.
_WIDEST = 5.0
#: Sine of the angle beyond grazing light at which relief shading becomes black.
_BEYOND_GRAZING = 0.342
#: Largest opacity of relief shading over the colors of a map.
_SHADE_OPACITY = 0.8
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


def encode(picture: NDArray[np.uint8], kind: str, **options: Any) -> bytes:
    """Image file of a picture H×W, H×W×2 (gray, alpha), H×W×3 or H×W×4.

    ResourceError if Pillow cannot write this kind: with too little memory to load a format's library, Pillow silently leaves the
    format out.
    """
    if kind not in Image.SAVE:
        Image.init()
    if kind not in Image.SAVE:
        raise ResourceError(
            f"Pillow cannot write {kind}: too little memory to load its library, or a Pillow that was built without it"
        )
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(picture)).save(buffer, kind, **options)
    return buffer.getvalue()


def data_url(picture: NDArray[np.uint8], kind: str, **options: Any) -> str:
    """Address for a web page that contains the picture itself; as `encode`."""
    return f"data:image/{kind.lower()};base64,{base64.b64encode(encode(picture, kind, **options)).decode()}"


def reduced(raster: NDArray[Any], step: int) -> Raster:
    """Means over blocks of step × step pixels, NaN left out; the last block of a row or column may be smaller."""
    if step == 1:
        return raster.astype(np.float32)
    rows, columns = np.arange(0, raster.shape[0], step), np.arange(0, raster.shape[1], step)
    known = np.isfinite(raster)

    def sums(values: NDArray[Any]) -> NDArray[np.float64]:
        return np.asarray(np.add.reduceat(np.add.reduceat(values, rows, axis=0, dtype=np.float64), columns, axis=1))

    count = sums(known)
    total = sums(np.where(known, raster, 0))
    return np.where(count > 0, total / np.maximum(count, 1), np.nan).astype(np.float32)


def step_for(shape: Sequence[int], limit: int) -> int:
    """Smallest block size with which no side is longer than the limit."""
    return max(1, -(-max(shape[0], shape[1]) // limit))


def flattened(depth: Raster) -> Raster:
    """Relief of a depth map, towards the camera: minus the depth, without the plane that fits it."""
    relief = -depth.astype(float)
    known = np.isfinite(relief)
    v, u = np.nonzero(known)
    design = np.stack([u, v, np.ones(len(u))], -1)
    stride = max(1, len(u) // 20000)
    coefficients = np.linalg.lstsq(design[::stride], relief[known][::stride], rcond=None)[0]
    relief[known] -= design @ coefficients
    return relief.astype(np.float32)


def _slope(relief: Raster, axis: int) -> Raster:
    """Mean of the differences to both neighbors along an axis; at borders the difference to the only neighbor, without neighbors 0."""
    steps = np.diff(relief, axis=axis)
    empty = np.full_like(np.take(relief, [0], axis=axis), np.nan)
    before, after = np.concatenate([empty, steps], axis), np.concatenate([steps, empty], axis)
    slope = np.where(np.isnan(before), after, np.where(np.isnan(after), before, (before + after) / 2))
    return np.nan_to_num(slope)


def hillshade(relief: Raster, pixel: float, azimuth_deg: float = 315, altitude_deg: float = 45) -> Raster:
    """Relief shading, 0 … 1, NaN where there is no relief; not stretched, so that two pictures can be compared.

    It is linear in the cosine of the angle between normal and light, and reaches black 20° beyond the grazing angle, so that round
    objects show form on their side away from the light. The light comes from `azimuth_deg` (clockwise from up) and `altitude_deg`;
    `pixel`: size of a pixel in the relief's unit.
    """
    azimuth, altitude = np.radians(azimuth_deg), np.radians(altitude_deg)
    right, up = _slope(relief, 1) / pixel, -_slope(relief, 0) / pixel
    towards = np.sin(altitude) - np.cos(altitude) * (np.sin(azimuth) * right + np.cos(azimuth) * up)
    cosine = towards / np.sqrt(1 + right**2 + up**2)
    shade = np.clip((cosine + _BEYOND_GRAZING) / (1 + _BEYOND_GRAZING), 0, 1)
    return np.where(np.isfinite(relief), shade, np.nan).astype(np.float32)


def gray(shade: Raster) -> NDArray[np.uint8]:
    """Shading 0 … 1 as gray with alpha, transparent where it is NaN."""
    known = np.isfinite(shade)
    level = np.rint(255 * np.clip(np.where(known, shade, 0), 0, 1)).astype(np.uint8)
    return np.stack([level, np.where(known, 255, 0).astype(np.uint8)], -1)


def new_drawing(width_in: float, height_in: float, layout: Literal["constrained"] | None = None) -> Drawing:
    """An empty drawing, sides in inches."""
    from matplotlib.figure import Figure as Drawing

    return Drawing(figsize=(width_in, height_in), layout=layout)


def _few_ticks(most: int) -> Any:
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(most)


def _outline(color: str) -> list[Any]:
    from matplotlib.patheffects import withStroke

    return [withStroke(linewidth=2.5, foreground=color)]


def _two_colors(first: str, second: str) -> Colormap:
    from matplotlib.colors import ListedColormap

    return ListedColormap([first, second])


def _draw(drawing: Drawing) -> NDArray[np.uint8]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    drawing.set_dpi(_DPI)
    canvas = FigureCanvasAgg(drawing)
    canvas.draw()  # type: ignore[no-untyped-call]
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()  # type: ignore[no-untyped-call]


def _over_bar(shape: Sequence[int], bar_in: float) -> tuple[Drawing, Any]:
    """A drawing with axes for a picture of this shape over the whole width, and `bar_in` inches of space below it."""
    drawing = new_drawing(WIDTH_IN, WIDTH_IN * shape[0] / shape[1] + bar_in)
    below = bar_in / drawing.get_figheight()
    return drawing, drawing.add_axes((0, below, 1, 1 - below))


def _beyond(colored: Any) -> Literal["neither", "min", "max", "both"]:
    """At which ends of its color scale a picture or points have values beyond the scale."""
    values = np.asarray(colored.get_array(), dtype=float)
    known, (low, high) = values[np.isfinite(values)], colored.get_clim()
    if not known.size:
        return "neither"
    below, above = bool((known < low).any()), bool((known > high).any())
    return "both" if below and above else "min" if below else "max" if above else "neither"


def color_bar(drawing: Drawing, colored: Any, label: str, ticks: Mapping[float, str] | None = None) -> None:
    """Add the color bar of a picture or of points below it, with the unit; an arrow at its end stands for values beyond its limits."""
    height = _BAR_IN / drawing.get_figheight()
    axes = drawing.add_axes((0.15, height * 0.62, 0.65, height * 0.2))
    bar = drawing.colorbar(colored, cax=axes, orientation="horizontal", extend=_beyond(colored))
    bar.outline.set_linewidth(0.4)
    axes.tick_params(labelsize=LETTERS_PT, length=2)
    if ticks:
        bar.set_ticks(list(ticks), labels=list(ticks.values()))
    else:
        bar.locator = _few_ticks(4)
        bar.update_ticks()
    if label:
        drawing.text(0.82, height * 0.72, label, fontsize=LETTERS_PT, va="center")


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


def style(axes: Any) -> None:
    """Thin axes with a light grid."""
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.tick_params(labelsize=LETTERS_PT, color="#8a8f96")
    axes.grid(color="#e3e6ea", lw=0.6)
    axes.set_axisbelow(True)


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
        return Figure(name, title, caption, _draw(drawing), header, rows, drawing if self.for_print else None, seen)

    # ---- maps ----

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
        return self._map(
            name, title, caption, raster, "RdBu", unit, limits=(-spread, spread), shade=shade, labels=labels
        )

    def plain_map(self, name: str, title: str, caption: str, raster: Raster, unit: str) -> Figure:
        """Map of positive values at the size of the pictures."""
        return self._map(name, title, caption, raster, "viridis", unit)

    def _map(
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
        finite = raster[np.isfinite(raster)].astype(float)
        if limits is None:
            limits = tuple(np.percentile(finite, [1, 99])) if finite.size else (0.0, 1.0)
        shape = raster.shape
        drawing, axes = _over_bar(shape, _BAR_IN if unit or ticks else 0.0)
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
            text.set_path_effects(_outline("black"))
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
        text.set_path_effects(_outline("white"))

    def shadings(self) -> Iterator[Figure]:
        """Relief shading of prior and fused surface, the fused one from two more directions."""
        about = "Relief shading of the depth map after one plane is taken out, light 45° above the plane from the "
        for surface, view, azimuth, side in (
            ("prior", "", 315, "upper left"),
            ("fused", "", 315, "upper left"),
            ("fused", "_right", 45, "upper right"),
            ("fused", "_below", 180, "bottom"),
        ):
            called = self.words[surface]
            label = f"{called.capitalize()} ({'coarse' if surface == 'prior' else self.quality['method']})"
            yield self._map(
                f"hillshade_{called}{view}",
                f"{label}, light from the {side}",
                about + side + ".",
                self.shade(surface, azimuth),
                "gray",
                limits=(0, 1),
            )

    def elevations(self) -> Iterator[Figure]:
        """Elevation of prior and fused surface above the plane that fits them (Fig. 8)."""
        finite = self.relief["fused"][np.isfinite(self.relief["fused"])]
        low, high = (float(p) for p in np.percentile(finite, [0.5, 99.5]))
        for surface in ("prior", "fused"):
            yield self._map(
                f"elevation_{self.words[surface]}",
                f"Elevation, {self.words[surface]}",
                "Along the optical axis, above the plane that fits the depth map; positive towards the camera. "
                "Relief shading over the colors.",
                self.relief[surface],
                "viridis",
                self.unit,
                limits=(low, high),
                shade=self.shade(surface),
            )

    def polarization(self) -> Iterator[Figure]:
        """Intensity, degree, phase, zenith, residual and labels (Fig. 5)."""
        folder = "polarization/"
        yield self._map(
            "intensity", "Unpolarized intensity", "Mean over a turn of the polarizer.",
            self.raster(folder + "unpolarized.tif"), "gray", "of white",
        )  # fmt: skip
        yield self._map(
            "degree", "Degree of linear polarization", "Amplitude of the fitted sinusoid over its mean.",
            self.raster(folder + "degree.tif"), "viridis", "ρ",
        )  # fmt: skip
        yield self._map(
            "phase", "Phase", "Polarizer angle of the brightest image, counter-clockwise from image +x.",
            np.degrees(self.thinned(folder + "phase.tif")), "twilight", "°", limits=(0, 180),
            ticks={float(angle): str(angle) for angle in range(0, 181, 45)},
        )  # fmt: skip
        if self.workspace.has(folder + "zenith.tif"):
            yield self._map(
                "zenith", "Zenith from the degree", "Angle of normal and viewing ray, from the degree by Fresnel's equations.",
                np.degrees(self.raster(folder + "zenith.tif")), "magma", "°",
            )  # fmt: skip
        if self.workspace.has(folder + "clamped.png"):
            labeled = self.thinned(folder + "label.png") > 0
            yield self._map(
                "clamped", "Zenith clamped",
                "Where the degree is beyond what its reflection can give, so that the zenith is the largest. White: no zenith.",
                np.where(labeled, self.thinned(folder + "clamped.png") / np.float32(255), np.float32(np.nan)),
                _two_colors("#d9dde2", "#d1495b"), limits=(0, 1), ticks={0.25: "measured", 0.75: "clamped"},
            )  # fmt: skip
        yield self._map(
            "residual", "Residual of the fit", "In expected standard deviations: 1 is noise alone.",
            self.raster(folder + "residual.tif"), "inferno", "σ", limits=(0, 3),
            ticks={0.0: "0", 1.0: "1", 2.0: "2", 3.0: "≥ 3"},
        )  # fmt: skip
        labels = self.thinned("fused/label.png" if self.workspace.has("fused/label.png") else folder + "label.png")
        yield self._map(
            "reflection", "Kind of reflection", "Which reflection dominates the polarization of a pixel. White: not known.",
            np.where(labels > 0, labels, np.nan).astype(np.float32), _two_colors("#3a7ca5", "#e0a13b"),
            limits=(0.5, 2.5), ticks={1.0: "diffuse", 2.0: "specular"},
        )  # fmt: skip

    def height(self) -> Iterator[Figure]:
        """Height from polarization alone as a map and as relief (Fig. 6 and 7); none if it could not be computed."""
        if self.quality["polarization_height"] is None:
            return
        raster = self.raster("height/height.tif")
        if not np.isfinite(raster).any():  # No light was found, or it comes from where the camera is.
            return
        shade = hillshade(flattened(-raster), float(self.step))
        yield self._map(
            "polarization_height",
            "Height from polarization alone",
            "In pixels, before any fusion. Relief shading over the colors.",
            raster,
            "viridis",
            "GSD",
            shade=shade,
        )
        yield self._map(
            "polarization_relief", "Its relief shading", "Light from the upper left.", shade, "gray", limits=(0, 1)
        )

    def trust_picture(self) -> NDArray[np.uint8]:
        """The relief shading, tinted by whether the surface is refined or the prior's, H × W × 3. Pixels without usable polarization
        count as the prior's: they only follow their neighbors.
        """
        refined, prior = np.array([53, 167, 160]), np.array([230, 159, 60])
        usable = self.workspace.raster("polarization/valid.png") == 255
        share = (self.small(self.workspace.raster("fused/trust.png") * usable) / np.float32(255))[..., None]
        tint = share * refined + (1 - share) * prior
        shade = np.nan_to_num(self.shade("fused"))[..., None]
        known = np.isfinite(self.relief["fused"])[..., None]
        return np.where(known, np.clip((0.25 + shade) * tint, 0, 255), 255).astype(np.uint8)

    def uncertainty(self) -> Iterator[Figure]:
        """Maps of the standard deviation of the fused depth, of the change by fusion, of trust and of the weight of polarization."""
        yield self._map(
            "sigma", "Standard deviation of the fused depth", "One σ, along the optical axis.",
            self.raster("fused/sigma.tif"), "viridis", self.unit,
        )  # fmt: skip
        difference = self.raster("fused/depth.tif") - self.raster("prior/depth.tif")
        spread = float(np.nanpercentile(np.abs(difference), 98)) or 1.0
        yield self._map(
            "fused_minus_prior", "Fused minus prior depth",
            "Negative (blue): the fused surface lies in front of the prior; positive (red): behind it.",
            # Depth grows away from the camera; blue is in front in this map as in all others.
            difference, "RdBu_r", self.unit, limits=(-spread, spread),
        )  # fmt: skip
        for name, title, caption, none, full in (
            ("trust", "Share of the refined surface",
             "Refined where the reflection model explains the polarization and what it changes stands out of the noise.", "prior", "refined"),
            ("confidence", "Weight of polarization", "Which pixels' polarization the refinement believed.", "none", "full"),
        ):  # fmt: skip
            if self.workspace.has(f"fused/{name}.png"):
                known = np.isfinite(self.relief["fused"])
                share = np.where(known, self.raster(f"fused/{name}.png") / np.float32(255), np.float32(np.nan))
                ticks = {0.0: none, 0.5: "half", 1.0: full}
                yield self._map(name, title, caption, share, "cividis", limits=(0, 1), ticks=ticks)

    def reference(self) -> Iterator[Figure]:
        """Signed distances to the reference, and their histogram."""
        if self.quality["reference"] and self.workspace.has("fused/reference_distance.tif"):
            yield from self._distances("reference", "Distance to the reference", self.quality["reference"])

    def m3c2(self) -> Iterator[Figure]:
        """Signed M3C2 distances to the reference, and their histogram."""
        if self.workspace.m3c2 and self.workspace.has("fused/m3c2_distance.tif"):
            yield from self._distances("m3c2", "M3C2 distance to the reference", self.workspace.m3c2)

    def _distances(self, name: str, title: str, figures: Mapping[str, Any]) -> Iterator[Figure]:
        raster = self.raster(f"fused/{name}_distance.tif") / np.float32(self.gsd)
        caption = "Positive (blue): the surface lies in front of the reference."
        yield self.signed_map(f"{name}_distance", title, caption, raster, "GSD")
        yield self._histogram(
            f"{name}_histogram", f"{title}, histogram", "distance [GSD]", {"fused": figures["histogram_gsd"]}, {}
        )

    # ---- plots ----

    def on_image(self, *, with_bar: bool = False) -> tuple[Drawing, Any]:
        """A drawing of the unpolarized image, and its axes in pixels of `raster`, to draw on it; with_bar: with space for a
        `color_bar` below."""
        intensity = self.raster("polarization/unpolarized.tif")
        drawing, axes = _over_bar(intensity.shape, _BAR_IN if with_bar else 0.0)
        low, high = np.nanpercentile(intensity, [1, 99])
        axes.imshow(intensity, cmap="gray", vmin=low, vmax=high)
        axes.set_axis_off()
        axes.set(xlim=(-0.5, intensity.shape[1] - 0.5), ylim=(intensity.shape[0] - 0.5, -0.5))
        self._scale_bar(axes, intensity.shape[1])
        return drawing, axes

    @staticmethod
    def tag(axes: Any, at: Any, word: str) -> None:
        """Write a name above a point, such as a box's upper left corner or a line's start; left of it if there is no space above.

        Text between two $ in a user's name is no formula.
        """
        bottom, top = axes.get_ylim()
        above = at[1] - top > 0.1 * (bottom - top)
        axes.annotate(
            word, at, xytext=(0, 8) if above else (-8, -5), textcoords="offset points", color="white", fontsize=LETTERS_PT,
            ha="left" if above else "right", va="bottom" if above else "top",
            bbox={"boxstyle": "round,pad=0.25", "fc": "#d1495b", "ec": "none"}, parse_math=False,
        )  # fmt: skip

    def profile_lines(self) -> Figure:
        """The lines of the sections on the unpolarized image (Fig. 11)."""
        drawing, axes = self.on_image()
        rows = []
        called, said = names_in_picture([profile["name"] for profile in self.quality["profiles"]])
        for profile, name in zip(self.quality["profiles"], called, strict=True):
            (u0, v0), (u1, v1) = profile["from_px"], profile["to_px"]
            rows.append([profile["name"], u0, v0, u1, v1])
            line = np.array([[u0, v0], [u1, v1]]) / self.step
            axes.plot(*line.T, color="white", lw=3, solid_capstyle="round")
            axes.plot(*line.T, color="#d1495b", lw=1.6, solid_capstyle="round")
            self.tag(axes, line[0], name)
        return self.figure(
            "profile_lines", "Where the profiles run", "On the unpolarized image; the name stands at the start." + said,
            drawing, ["profile", "from_u_px", "from_v_px", "to_u_px", "to_v_px"], rows,
        )  # fmt: skip

    def profiles(self) -> Iterator[Figure]:
        """Sections through prior, polarization height and fused surface (Fig. 12 and 13), and the detail of prior and fused surface."""
        sigma_px = float(self.workspace.manifest["options"]["assess"]["detail_sigma_px"])
        to_micrometers = 1e6 * METERS[self.unit]
        for number, profile in enumerate(self.quality["profiles"], 1):
            drawing = new_drawing(WIDTH_IN, 6.2, "constrained")
            above, below = drawing.subplots(2, 1, sharex=True, height_ratios=(5, 4))
            along = numbers(profile["position"])
            present = [name for name in COLORS if any(height is not None for height in profile[name])]
            step = float(np.median(np.diff(along))) / self.gsd if len(along) > 1 else 1.0
            details = {
                name: to_micrometers * without_form(numbers(profile[name]), sigma_px / max(step, 1e-9))
                for name in present
                if name != "polarization"
            }
            for axes, lines in ((above, {name: numbers(profile[name]) for name in present}), (below, details)):
                for name, values in lines.items():
                    axes.plot(
                        along, values, color=COLORS[name], lw=1.6 if name == "fused" else 1.2, label=self.words[name]
                    )
                axes.margins(x=0.01)
                style(axes)
                axes.yaxis.set_major_locator(_few_ticks(5))
            beyond = self._cut_spikes(below, along, details)
            above.set_ylabel(f"height [{self.unit}]", fontsize=LETTERS_PT)
            above.legend(fontsize=LETTERS_PT, frameon=False, ncols=3, loc="lower left", bbox_to_anchor=(0, 1),
                         borderaxespad=0, columnspacing=1, handlelength=1.2)  # fmt: skip
            below.set_ylabel("detail [µm]", fontsize=LETTERS_PT)
            below.set_xlabel(f"along the profile [{self.unit}]", fontsize=LETTERS_PT)
            columns = [profile["position"], *(profile[name] for name in present), *details.values()]
            spread = ", ".join(
                f"{self.words[name]} {readable(float(np.nanstd(values)), 2)} µm" for name, values in details.items()
            )
            called = [self.words[name] for name in present]
            yield self.figure(
                f"profile_{number}", f"Profile {profile['name']}",
                f"Above: height over the chord of the section of {self.words['fused']}, towards the camera; polarization alone has "
                f"no absolute height. Below: what is finer than {sigma_px:g} px ({shown(sigma_px * self.gsd, self.unit)}), its form taken out"
                + ("." if not beyond else f"; cut off at the triangles, where {', '.join(beyond)}."),
                drawing,
                [f"position_{self.unit}", *(f"{word}_{self.unit}" for word in called), *(f"{self.words[name]}_detail_um" for name in details)],
                list(zip(*columns, strict=True)), f"A section of {readable(float(along[-1]) if len(along) else 0)} {self.unit}. Spread of the detail: {spread}.",
            )  # fmt: skip

    def _cut_spikes(self, axes: Any, along: NDArray[np.float64], lines: Mapping[str, NDArray[np.float64]]) -> list[str]:
        """Limit the axes so that all but a few extreme values can be read, with a triangle where a line is cut off. Returns, in
        words, the full range of each line that was cut off.
        """
        limits = _without_spikes(list(lines.values()))
        if limits is None:
            return []
        axes.set_ylim(*limits)
        said = []
        for name, values in lines.items():
            known = np.nan_to_num(values)
            for limit, marker, far in ((limits[0], "v", known < limits[0]), (limits[1], "^", known > limits[1])):
                runs = np.split(np.arange(len(known)), np.nonzero(np.diff(far))[0] + 1)
                tips = [run[np.argmax(np.abs(known[run]))] for run in runs if len(run) and far[run[0]]]
                axes.plot(along[tips], [limit] * len(tips), marker, color=COLORS[name], ms=7, clip_on=False, zorder=6)
            if known.min() < limits[0] or known.max() > limits[1]:
                said.append(
                    f"{self.words[name]} reaches from {printed(f'{known.min():.0f}')} to {printed(f'{known.max():.0f}')} µm"
                )
        return said

    def _histogram(
        self, name: str, title: str, axis: str, bins: Mapping[str, Mapping[str, Any]], notes: Mapping[str, str]
    ) -> Figure:
        drawing = new_drawing(WIDTH_IN, 4.4, "constrained")
        axes = drawing.subplots()
        # Shares are scaled to one class width, so that histograms with different classes can be compared.
        width = min(float(histogram["bin_width"]) for histogram in bins.values())
        low, high = _common_range(bins)
        beyond, classes = [], []
        for surface, histogram in bins.items():
            counts = np.array(histogram["counts"], dtype=float)
            edges = histogram["low"] + histogram["bin_width"] * np.arange(len(counts) + 1)
            total = counts.sum() + histogram["below"] + histogram["above"]
            inside = counts[(edges[1:] > low) & (edges[:-1] < high)].sum()
            if inside < total:
                beyond.append(f"{self.words[surface]} {readable(100 * (total - inside) / total, 2)} %")
            classes.append(f"{readable(histogram['bin_width'], 2)} ({self.words[surface]})")
            axes.stairs(
                100 * counts / max(total, 1) * width / histogram["bin_width"], edges, color=COLORS[surface], lw=1.5,
                fill=surface == "fused", alpha=0.85 if surface == "fused" else 1, label=notes.get(surface),
                zorder=2 if surface == "fused" else 3,
            )  # fmt: skip
        axes.set_xlim(low - 0.05 * (high - low), high + 0.05 * (high - low))
        axes.set_xlabel(axis, fontsize=LETTERS_PT)
        axes.set_ylabel(f"share of pixels in {readable(width, 2)} GSD [%]", fontsize=LETTERS_PT)
        style(axes)
        axes.xaxis.set_major_locator(_few_ticks(6))
        if notes:
            axes.legend(fontsize=LETTERS_PT, frameon=False, loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0)
        rows = [
            [
                self.words[surface],
                histogram["low"] + k * histogram["bin_width"],
                histogram["low"] + (k + 1) * histogram["bin_width"],
                n,
            ]
            for surface, histogram in bins.items()
            for k, n in enumerate(histogram["counts"])
        ]
        header = ["surface", "from_gsd", "to_gsd", "count"]
        caption = (
            f"Share of the pixels in each {readable(width, 2)} GSD of distance, in classes of {', '.join(classes)} GSD."
        )
        if beyond:
            caption += f" Beyond the scale: {', '.join(beyond)}."
        return self.figure(name, title, caption, drawing, header, rows)

    def patches(self) -> Iterator[Figure]:
        """Distances of flat patches to their fitted planes (Fig. 15)."""
        for number, patch in enumerate(self.quality["patches"], 1):
            fits = {name: patch[name] for name in COLORS if patch[name] is not None}
            if fits:
                yield self._histogram(
                    f"patch_{number}",
                    f"Patch {patch['name']}",
                    "distance to the fitted plane [GSD]",
                    {name: fit["histogram_gsd"] for name, fit in fits.items()},
                    {name: f"{self.words[name]}: RMSE {readable(fit['rmse_gsd'])} GSD" for name, fit in fits.items()},
                )


def can_be_drawn(name: str) -> bool:
    """Whether matplotlib can write a name: its font has all letters, and they run from left to right."""
    from matplotlib.font_manager import FontProperties, findfont, get_font

    font = get_font(findfont(FontProperties()))
    return all(
        font.get_char_index(ord(letter)) != 0 and unicodedata.bidirectional(letter) not in ("R", "AL")
        for letter in name
    )


def names_in_picture(names: Sequence[str]) -> tuple[list[str], str]:
    """What a picture calls things: their names, or numbers such as (2) for names that `can_be_drawn` refuses; and a sentence for the
    caption that says which name each number stands for, "" if there is none.
    """
    called = [name if can_be_drawn(name) else f"({number})" for number, name in enumerate(names, 1)]
    said = ", ".join(f"{one} is {name}" for one, name in zip(called, names, strict=True) if one != name)
    return called, f" {said}." if said else ""


def _common_range(bins: Mapping[str, Mapping[str, Any]]) -> tuple[float, float]:
    """Ends of an axis for histograms of several surfaces: the range of all counted values, limited so that the narrowest histogram
    can be read."""
    ends = []
    for histogram in bins.values():
        used = np.nonzero(histogram["counts"])[0]
        if used.size:
            first, last = used[0], used[-1] + 1
            ends.append(tuple(histogram["low"] + histogram["bin_width"] * at for at in (first, last)))
    if not ends:
        return 0.0, 1.0
    narrow = min(ends, key=lambda pair: pair[1] - pair[0])
    middle, reach = (narrow[0] + narrow[1]) / 2, _WIDEST / 2 * (narrow[1] - narrow[0])
    low, high = min(pair[0] for pair in ends), max(pair[1] for pair in ends)
    return float(max(low, middle - reach)), float(min(high, middle + reach))


def without_form(section: NDArray[np.float64], sigma: float) -> NDArray[np.float64]:
    """A section without its form, which is the parabola fitted around each sample, weighted by a Gaussian of `sigma` samples.

    A parabola is fitted, not a mean, because slope and curvature of the object are form, too: those of a nose would be larger than
    the detail on it. Missing samples (NaN) get no weight.
    """
    reach = max(1, int(np.ceil(3 * sigma)))
    offset = np.arange(-reach, reach + 1) / sigma
    weight = np.exp(-0.5 * offset**2)
    known = np.isfinite(section)
    values = np.where(known, section, 0)

    def sums(terms: NDArray[Any], power: int) -> NDArray[np.float64]:
        # Reversed, because a convolution counts offsets backwards.
        return np.convolve(terms, (weight * offset**power)[::-1])[reach : reach + len(section)]

    moments = [sums(known.astype(float), power) for power in range(5)]
    normal = np.stack([np.stack(moments[row : row + 3], -1) for row in range(3)], -2)
    # With fewer than three known samples this yields a line or a mean; with none, the 1 keeps the matrix regular.
    normal += np.where(moments[0] > 0, 1e-12 * moments[0], 1)[:, None, None] * np.eye(3)
    right = np.stack([sums(values, power) for power in range(3)], -1)
    form = np.linalg.solve(normal, right[..., None])[:, 0, 0]
    return np.where(known, section - form, np.nan)


def _without_spikes(lines: Sequence[NDArray[np.float64]]) -> tuple[float, float] | None:
    """Limits of an axis that leave out a few extreme values, so that all other values can be read; None if there are no extreme values."""
    values = np.concatenate([line[np.isfinite(line)] for line in lines]) if lines else np.empty(0)
    if values.size == 0:
        return None
    low, high = (float(p) for p in np.percentile(values, (5, 95)))
    low, high = low - (high - low), high + (high - low)
    if values.min() >= low and values.max() <= high:
        return None
    return max(low, float(values.min())), min(high, float(values.max()))


def numbers(values: Sequence[float | None]) -> NDArray[np.float64]:
    """Numbers of quality.json as an array, NaN for None."""
    return np.array(values, dtype=float)
