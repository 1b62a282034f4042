"""Maps of a workspace's rasters: shading, elevation, polarization, height, uncertainty."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from malus.figures.drawing import two_colors
from malus.figures.figure import Figure
from malus.figures.plates import Plates
from malus.relief import flattened, hillshade


def shadings(plates: Plates) -> Iterator[Figure]:
    """Relief shading of prior and fused surface, the fused one from two more directions."""
    about = "Relief shading of the depth map after one plane is taken out, light 45° above the plane from the "
    for surface, view, azimuth, side in (
        ("prior", "", 315, "upper left"),
        ("fused", "", 315, "upper left"),
        ("fused", "_right", 45, "upper right"),
        ("fused", "_below", 180, "bottom"),
    ):
        called = plates.words[surface]
        label = f"{called.capitalize()} ({'coarse' if surface == 'prior' else plates.quality['method']})"
        yield plates.map(
            f"hillshade_{called}{view}",
            f"{label}, light from the {side}",
            about + side + ".",
            plates.shade(surface, azimuth),
            "gray",
            limits=(0, 1),
        )


def elevations(plates: Plates) -> Iterator[Figure]:
    """Elevation of prior and fused surface above the plane that fits them (Fig. 8)."""
    finite = plates.relief["fused"][np.isfinite(plates.relief["fused"])]
    low, high = (float(p) for p in np.percentile(finite, [0.5, 99.5]))
    for surface in ("prior", "fused"):
        yield plates.map(
            f"elevation_{plates.words[surface]}",
            f"Elevation, {plates.words[surface]}",
            "Along the optical axis, above the plane that fits the depth map; positive towards the camera. "
            "Relief shading over the colors.",
            plates.relief[surface],
            "viridis",
            plates.unit,
            limits=(low, high),
            shade=plates.shade(surface),
        )


def polarization(plates: Plates) -> Iterator[Figure]:
    """Intensity, degree, phase, zenith, residual and labels (Fig. 5)."""
    folder = "polarization/"
    yield plates.map(
        "intensity", "Unpolarized intensity", "Mean over a turn of the polarizer.",
        plates.raster(folder + "unpolarized.tif"), "gray", "of white",
    )  # fmt: skip
    yield plates.map(
        "degree", "Degree of linear polarization", "Amplitude of the fitted sinusoid over its mean.",
        plates.raster(folder + "degree.tif"), "viridis", "ρ",
    )  # fmt: skip
    yield plates.map(
        "phase", "Phase", "Polarizer angle of the brightest image, counter-clockwise from image +x.",
        np.degrees(plates.thinned(folder + "phase.tif")), "twilight", "°", limits=(0, 180),
        ticks={float(angle): str(angle) for angle in range(0, 181, 45)},
    )  # fmt: skip
    if plates.workspace.has(folder + "zenith.tif"):
        yield plates.map(
            "zenith", "Zenith from the degree", "Angle of normal and viewing ray, from the degree by Fresnel's equations.",
            np.degrees(plates.raster(folder + "zenith.tif")), "magma", "°",
        )  # fmt: skip
    if plates.workspace.has(folder + "clamped.png"):
        labeled = plates.thinned(folder + "label.png") > 0
        yield plates.map(
            "clamped", "Zenith clamped",
            "Where the degree is beyond what its reflection can give, so that the zenith is the largest. White: no zenith.",
            np.where(labeled, plates.thinned(folder + "clamped.png") / np.float32(255), np.float32(np.nan)),
            two_colors("#d9dde2", "#d1495b"), limits=(0, 1), ticks={0.25: "measured", 0.75: "clamped"},
        )  # fmt: skip
    yield plates.map(
        "residual", "Residual of the fit", "In expected standard deviations: 1 is noise alone.",
        plates.raster(folder + "residual.tif"), "inferno", "σ", limits=(0, 3),
        ticks={0.0: "0", 1.0: "1", 2.0: "2", 3.0: "≥ 3"},
    )  # fmt: skip
    labels = plates.thinned("fused/label.png" if plates.workspace.has("fused/label.png") else folder + "label.png")
    yield plates.map(
        "reflection", "Kind of reflection", "Which reflection dominates the polarization of a pixel. White: not known.",
        np.where(labels > 0, labels, np.nan).astype(np.float32), two_colors("#3a7ca5", "#e0a13b"),
        limits=(0.5, 2.5), ticks={1.0: "diffuse", 2.0: "specular"},
    )  # fmt: skip


def height(plates: Plates) -> Iterator[Figure]:
    """Height from polarization alone as a map and as relief (Fig. 6 and 7); none if it could not be computed."""
    if plates.quality["polarization_height"] is None:
        return
    raster = plates.raster("height/height.tif")
    if not np.isfinite(raster).any():  # No light was found, or it comes from where the camera is.
        return
    shade = hillshade(flattened(-raster), float(plates.step))
    yield plates.map(
        "polarization_height",
        "Height from polarization alone",
        "In pixels, before any fusion. Relief shading over the colors.",
        raster,
        "viridis",
        "GSD",
        shade=shade,
    )
    yield plates.map(
        "polarization_relief", "Its relief shading", "Light from the upper left.", shade, "gray", limits=(0, 1)
    )


def uncertainty(plates: Plates) -> Iterator[Figure]:
    """Maps of the standard deviation of the fused depth, of the change by fusion, of trust and of the weight of polarization."""
    yield plates.map(
        "sigma", "Standard deviation of the fused depth", "One σ, along the optical axis.",
        plates.raster("fused/sigma.tif"), "viridis", plates.unit,
    )  # fmt: skip
    difference = plates.raster("fused/depth.tif") - plates.raster("prior/depth.tif")
    spread = float(np.nanpercentile(np.abs(difference), 98)) or 1.0
    yield plates.map(
        "fused_minus_prior", "Fused minus prior depth",
        "Negative (blue): the fused surface lies in front of the prior; positive (red): behind it.",
        # Depth grows away from the camera; blue is in front in this map as in all others.
        difference, "RdBu_r", plates.unit, limits=(-spread, spread),
    )  # fmt: skip
    for name, title, caption, none, full in (
        ("trust", "Share of the refined surface",
         "Refined where the reflection model explains the polarization and what it changes stands out of the noise.", "prior", "refined"),
        ("confidence", "Weight of polarization", "Which pixels' polarization the refinement believed.", "none", "full"),
    ):  # fmt: skip
        if plates.workspace.has(f"fused/{name}.png"):
            known = np.isfinite(plates.relief["fused"])
            share = np.where(known, plates.raster(f"fused/{name}.png") / np.float32(255), np.float32(np.nan))
            ticks = {0.0: none, 0.5: "half", 1.0: full}
            yield plates.map(name, title, caption, share, "cividis", limits=(0, 1), ticks=ticks)


def trust_picture(plates: Plates) -> NDArray[np.uint8]:
    """The relief shading, tinted by whether the surface is refined or the prior's, H × W × 3. Pixels without usable polarization
    count as the prior's: they only follow their neighbors.
    """
    refined, prior = np.array([53, 167, 160]), np.array([230, 159, 60])
    usable = plates.workspace.raster("polarization/valid.png") == 255
    share = (plates.small(plates.workspace.raster("fused/trust.png") * usable) / np.float32(255))[..., None]
    tint = share * refined + (1 - share) * prior
    shade = np.nan_to_num(plates.shade("fused"))[..., None]
    known = np.isfinite(plates.relief["fused"])[..., None]
    return np.where(known, np.clip((0.25 + shade) * tint, 0, 255), 255).astype(np.uint8)
