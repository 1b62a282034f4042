"""The report's pictures, each drawn from a finished workspace."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LightSource
from matplotlib.figure import Figure
from numpy.typing import NDArray

from malus import _core

#: Long side of the pictures' data in pixels: larger rasters are thinned, a report is for looking.
MAX_SIDE_PX = 1600
#: Colours of the three surfaces in every plot.
COLORS = {"prior": "#9a6b3f", "polarization": "#3a7ca5", "fused": "#1b1b1b"}

Raster = NDArray[np.float32]


def read_raster(path: Path) -> Raster:
    """Float TIFF or 8-bit PNG of a workspace, H×W or H×W×3, float32."""
    raster: Raster = _core.read_raster(str(path))
    return raster


def to_png(figure: Figure) -> bytes:
    """Figure as a PNG file."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110, bbox_inches="tight")
    return buffer.getvalue()


def _thin(raster: Raster) -> Raster:
    step = max(1, -(-max(raster.shape[:2]) // MAX_SIDE_PX))
    return raster[::step, ::step]


def _show(
    axes: Axes,
    raster: Raster,
    title: str,
    *,
    cmap: str,
    limits: tuple[float, float] | None = None,
    label: str | None = None,
) -> None:
    finite = raster[np.isfinite(raster)]
    if limits is None and finite.size:
        low, high = np.percentile(finite, [1, 99])
        limits = (float(low), float(high))
    picture = axes.imshow(
        _thin(raster), cmap=cmap, vmin=limits[0] if limits else None, vmax=limits[1] if limits else None
    )
    axes.set_title(title, fontsize=10)
    axes.set_axis_off()
    if label is not None:
        bar = axes.figure.colorbar(picture, ax=axes, fraction=0.04, pad=0.02)
        bar.set_label(label, fontsize=8)
        bar.ax.tick_params(labelsize=7)


def _grid(rows: int, columns: int, shape: tuple[int, ...]) -> tuple[Figure, list[Axes]]:
    width = 5.4
    figure = Figure(
        figsize=(width * columns, width * rows * shape[0] / shape[1] * 0.9 + 0.4 * rows), layout="constrained"
    )
    return figure, list(np.atleast_1d(figure.subplots(rows, columns)).ravel())


def hillshade(depth: Raster, pixel: float) -> Raster:
    """Relief shading of a depth map lit from the upper left, 0 … 1, NaN where there is no depth; `pixel` is the GSD."""
    relief = -depth.astype(float)
    filled = np.where(np.isfinite(relief), relief, np.nanmedian(relief))
    # A plane takes out the pose of the object, so that the shading shows its form.
    v, u = np.mgrid[: depth.shape[0], : depth.shape[1]]
    ok = np.isfinite(relief)
    design = np.stack([u[ok], v[ok], np.ones(ok.sum())], -1)
    coefficients = np.linalg.lstsq(design[::37], relief[ok][::37], rcond=None)[0]
    filled = filled - (u * coefficients[0] + v * coefficients[1] + coefficients[2])
    shade = LightSource(azdeg=315, altdeg=40).hillshade(filled, dx=pixel, dy=pixel, vert_exag=1.0)
    return np.where(ok, shade, np.nan).astype(np.float32)


def surfaces(work: Path, quality: Mapping[str, Any]) -> Figure:
    """Relief shading of prior and fused surface side by side."""
    prior, fused = read_raster(work / "prior/depth.tif"), read_raster(work / "fused/depth.tif")
    figure, axes = _grid(1, 2, fused.shape)
    for ax, depth, title in ((axes[0], prior, "prior (stereo)"), (axes[1], fused, f"fused ({quality['method']})")):
        _show(ax, hillshade(depth, quality["gsd"]), title, cmap="gray", limits=(0.0, 1.0))
    return figure


def polarization(work: Path) -> Figure:
    """Intensity, degree, phase and zenith (the paper's Fig. 5), with the fit's residual and the labels."""
    folder = work / "polarization"
    intensity = read_raster(folder / "unpolarized.tif")
    figure, axes = _grid(3, 2, intensity.shape)
    _show(axes[0], intensity, "unpolarized intensity", cmap="gray", label="of white")
    _show(axes[1], read_raster(folder / "degree.tif"), "degree of linear polarization", cmap="viridis", label="ρ")
    phase = np.degrees(read_raster(folder / "phase.tif"))
    _show(axes[2], phase, "phase, counter-clockwise from image +x", cmap="twilight", limits=(0, 180), label="°")
    _show(axes[3], np.degrees(read_raster(folder / "zenith.tif")), "zenith from degree", cmap="magma", label="°")
    _show(
        axes[4],
        read_raster(folder / "residual.tif"),
        "residual of the fit over its expectation",
        cmap="inferno",
        limits=(0, 3),
        label="1 = noise",
    )
    label = read_raster(folder / "label.png")
    _show(
        axes[5], np.where(label > 0, label, np.nan), "reflection: 1 diffuse, 2 specular", cmap="cividis", limits=(1, 2)
    )
    return figure


def height(work: Path, quality: Mapping[str, Any]) -> Figure:
    """Height from polarization alone as a map and as relief (Fig. 6 and 7)."""
    raster = read_raster(work / "height/height.tif")
    figure, axes = _grid(1, 2, raster.shape)
    _show(axes[0], raster, "height from polarization alone", cmap="terrain", label="GSD")
    _show(axes[1], hillshade(-raster, 1.0), "the same, relief shading", cmap="gray", limits=(0.0, 1.0))
    return figure


def sigma(work: Path, quality: Mapping[str, Any]) -> Figure:
    """One standard deviation of the fused depth."""
    raster = read_raster(work / "fused/sigma.tif")
    figure, axes = _grid(1, 2, raster.shape)
    unit = quality["unit"]
    _show(axes[0], raster, "standard deviation of the fused depth", cmap="viridis", label=unit)
    difference = read_raster(work / "fused/depth.tif") - read_raster(work / "prior/depth.tif")
    spread = float(np.nanpercentile(np.abs(difference), 98)) or 1.0
    _show(axes[1], difference, "fused minus prior", cmap="RdBu", limits=(-spread, spread), label=unit)
    return figure


def profile_lines(work: Path, profiles: list[Mapping[str, Any]]) -> Figure:
    """Where the sections run, on the intensity image (Fig. 11)."""
    intensity = read_raster(work / "polarization/unpolarized.tif")
    figure, axes = _grid(1, 1, intensity.shape)
    low, high = np.nanpercentile(intensity, [1, 99])
    axes[0].imshow(intensity, cmap="gray", vmin=low, vmax=high)
    axes[0].set_axis_off()
    for profile in profiles:
        (u0, v0), (u1, v1) = profile["from_px"], profile["to_px"]
        axes[0].plot([u0, u1], [v0, v1], color="#e4572e", lw=1.5)
        axes[0].text(u0, v0, f" {profile['name']}", color="#e4572e", fontsize=12, va="bottom")
    return figure


def _values(values: list[float | None]) -> NDArray[np.float64]:
    return np.array([np.nan if value is None else value for value in values], dtype=float)


def profile(profile: Mapping[str, Any], unit: str) -> Figure:
    """One section through prior, polarization height and fused surface (Fig. 12 and 13)."""
    figure = Figure(figsize=(10, 3.2), layout="constrained")
    axes = figure.subplots()
    along = _values(profile["position"])
    for name, color in COLORS.items():
        if profile[name]:
            axes.plot(along, _values(profile[name]), color=color, lw=1.4 if name == "fused" else 1.0, label=name)
    axes.set_xlabel(f"along the section [{unit}]")
    axes.set_ylabel(f"height [{unit}]")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, frameon=False, ncols=3)
    return figure


def histogram(patch: Mapping[str, Any]) -> Figure:
    """Distances of a flat patch to its fitted plane, prior and fused (Fig. 15)."""
    figure = Figure(figsize=(5.4, 3.2), layout="constrained")
    axes = figure.subplots()
    for name in ("prior", "fused"):
        fit = patch[name]
        if fit is not None:
            bins = fit["histogram_gsd"]
            edges = bins["low"] + bins["bin_width"] * np.arange(len(bins["counts"]) + 1)
            shares = np.array(bins["counts"], dtype=float) / max(fit["count"], 1)
            axes.stairs(shares, edges, color=COLORS[name], lw=1.4, label=f"{name}: RMSE {fit['rmse_gsd']:.3f} GSD")
    axes.set_xlabel("distance to the fitted plane [GSD]")
    axes.set_ylabel("share of pixels")
    axes.set_title(f"patch {patch['name']}", fontsize=10)
    axes.legend(fontsize=8, frameon=False)
    return figure
