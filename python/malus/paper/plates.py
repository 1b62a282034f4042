"""The paper's figures beyond those of the report's own sections: sinusoids, the cloud, patches, oblique views."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus.figures import Figure, Plates
from malus.figures.drawing import LETTERS_PT, WIDTH_IN, color_bar, names_in_picture, new_drawing, style, tag
from malus.lengths import shown
from malus.relief import flattened, gray, hillshade
from malus.workspace import Raster

#: Tilt of the object in oblique views, and the step between two rows, in pixels, above which the wall between them is not drawn.
_TILT_DEG, _STEP_PX = 50.0, 60
#: Oblique views clip a relief to these percentiles, extended on both sides by a tenth of the range between them.
_RELIEF_PERCENTILES = (0.2, 99.8)
#: Largest number of points drawn; larger clouds are thinned evenly.
_MOST_POINTS = 40_000
#: Total printed area of the points on the surface, in square points; it sets the size of each point.
_POINTS_PT2 = 20_000
#: As many colors as pixels that a station may name.
_CURVE_COLORS = ("#2f7fb3", "#35a7a0", "#b0702a", "#d1495b", "#6b4c9a", "#5a8f29", "#8c8c8c", "#c2579f")


def sinusoids(plates: Plates) -> Iterator[Figure]:
    """Intensity against the polarizer's angle at a few pixels, with the fitted sinusoids (Fig. 1c)."""
    curves = plates.workspace.manifest["steps"]["polarization"]["notes"].get("curves")
    if not curves:
        return
    maps = {
        name: plates.workspace.raster(f"polarization/measured/{name}.tif")
        for name in ("unpolarized", "degree", "phase")
    }
    drawing = new_drawing(WIDTH_IN, 4.6, "constrained")
    axes = drawing.subplots()
    angles = np.linspace(0, 180, 181)
    rows: list[list[Any]] = []
    for color, curve in zip(_CURVE_COLORS, curves, strict=False):
        u, v = curve["u"], curve["v"]
        mean, degree, phase = (float(maps[name][v, u]) for name in ("unpolarized", "degree", "phase"))

        def fitted(at: Any, mean: float = mean, degree: float = degree, phase: float = phase) -> Any:
            return mean * (1 + degree * np.cos(2 * (np.radians(at) - phase)))

        axes.plot(angles, fitted(angles), color=color, lw=1.2)
        turned = np.mod(curve["angles_deg"], 180)
        axes.plot(turned, curve["intensities"], "o", ms=4, color=color, label=f"({u}, {v}): {degree:.3f}")
        rows += [
            [u, v, angle, intensity, float(fitted(angle)), degree, float(np.degrees(phase))]
            for angle, intensity in zip(curve["angles_deg"], curve["intensities"], strict=True)
        ]
    axes.set_xlabel("polarizer angle [°]", fontsize=LETTERS_PT)
    axes.set_ylabel("intensity [of white]", fontsize=LETTERS_PT)
    axes.set_xticks(range(0, 181, 30))
    drawing.legend(title="pixel: degree of polarization", title_fontsize=LETTERS_PT, fontsize=LETTERS_PT, frameon=False, ncols=2,
                   loc="outside upper center", borderaxespad=0, columnspacing=1, handlelength=1)  # fmt: skip
    style(axes)
    yield plates.figure(
        "sinusoids", "Intensity against polarizer angle",
        "Measured intensities (dots) of a few pixels (column, row), the sinusoid fitted to each, and its degree ρ. Unless "
        "pixels were named they are weakly to very strongly polarized ones.",
        drawing, ["u_px", "v_px", "angle_deg", "intensity", "fitted", "degree", "phase_deg"], rows,
    )  # fmt: skip


def cloud(plates: Plates) -> Iterator[Figure]:
    """The prior's cloud over the image it is projected into (Fig. 9)."""
    if not plates.workspace.has("prior/points.png"):
        return
    points = plates.workspace.raster("prior/points.png")
    depth = plates.workspace.raster("prior/depth.tif")
    drawing, axes = plates.on_image(with_bar=True)
    on, off = points > 200, (points > 0) & (points <= 200)
    counts = [int(on.sum()), int(off.sum())]
    for which in (off, on):
        v, u = np.nonzero(which)
        chosen = slice(None, None, max(1, -(-len(u) // _MOST_POINTS)))
        u, v = u[chosen], v[chosen]
        # If there are few points, they are drawn larger, so that they can be found in the picture.
        look: dict[str, Any] = (
            {"c": depth[v, u], "cmap": "viridis_r", "s": np.clip(_POINTS_PT2 / max(1, len(u)), 8, 40)}
            if which is on
            else {"c": "#d1495b", "s": 1.5}
        )
        drawn = axes.scatter(u / plates.step, v / plates.step, marker=".", linewidths=0, rasterized=True, **look)
        if which is on and len(u):
            color_bar(drawing, drawn, plates.unit)
    depths = depth[on & np.isfinite(depth)]
    low, high = (shown(float(d), plates.unit, 4) for d in (depths.min(), depths.max())) if depths.size else ("–", "–")
    yield plates.figure(
        "cloud", "Cloud in the station's view",
        f"Points of the cloud, projected into the unpolarized image: on the surface, by depth (bright is near; {low} to "
        f"{high}), and red those behind it or off it.",
        drawing, ["points", "pixels"], [["on the surface", counts[0]], ["behind or off", counts[1]]],
    )  # fmt: skip


def patch_boxes(plates: Plates) -> Iterator[Figure]:
    """Flat patches on the image (Fig. 14)."""
    from matplotlib.patches import Rectangle

    if not plates.quality["patches"]:
        return
    drawing, axes = plates.on_image()
    rows = []
    called, said = names_in_picture([patch["name"] for patch in plates.quality["patches"]])
    for patch, name in zip(plates.quality["patches"], called, strict=True):
        u0, v0, u1, v1 = patch["box"]
        rows.append([patch["name"], u0, v0, u1, v1])
        corner = (u0 / plates.step - 0.5, v0 / plates.step - 0.5)
        size = ((u1 - u0 + 1) / plates.step, (v1 - v0 + 1) / plates.step)
        axes.add_patch(Rectangle(corner, *size, fill=False, ec="white", lw=3))
        axes.add_patch(Rectangle(corner, *size, fill=False, ec="#d1495b", lw=1.6))
        tag(axes, corner, name)
    yield plates.figure(
        "patch_boxes", "Flat patches", "Where the distances to planes are measured." + said,
        drawing, ["patch", "u0_px", "v0_px", "u1_px", "v1_px"], rows,
    )  # fmt: skip


def oblique(relief: Raster, shade: Raster, tilt_deg: float = _TILT_DEG) -> NDArray[np.uint8]:
    """A relief seen obliquely from below, gray with alpha: parallel projection, nearer parts hide farther ones.

    relief: H×W, in pixels, towards the viewer. Every pixel is drawn as a column down to its neighbor, so that slopes have no gaps.
    """
    sine, cosine = np.sin(np.radians(tilt_deg)), np.cos(np.radians(tilt_deg))
    rows = np.arange(relief.shape[0])[:, None] * cosine - relief * sine
    rows = np.rint(rows - np.nanmin(rows))
    picture = np.full((int(np.nanmax(rows)) + 1, relief.shape[1]), np.nan, np.float32)
    for v in range(relief.shape[0]):  # from the far side to the near one
        columns = np.nonzero(np.isfinite(rows[v]))[0]
        last, before = rows[v, columns], rows[max(v - 1, 0), columns]
        first = np.fmin(before, last)
        first = np.where(last - first > _STEP_PX, last, first)
        for down in range(int((last - first).max(initial=0)) + 1):
            reached = first + down <= last
            picture[(first[reached] + down).astype(int), columns[reached]] = shade[v, columns[reached]]
    return gray(picture)


def views(plates: Plates) -> Iterator[Figure]:
    """Shaded oblique views of the three surfaces (Fig. 10)."""
    reliefs: dict[str, tuple[str, Raster, float]] = {}
    for name in ("prior", "fused"):
        called = plates.words[name]
        reliefs[called] = (called.capitalize(), plates.relief[name], plates.gsd * plates.step)
    if plates.quality["polarization_height"] is not None and plates.workspace.has("height/height.tif"):
        raster = plates.raster("height/height.tif")
        if np.isfinite(raster).any():
            reliefs["polarization"] = ("Polarization alone", flattened(-raster), float(plates.step))
    for name, (title, relief, pixel) in reliefs.items():
        low, high = (float(p) for p in np.nanpercentile(relief, _RELIEF_PERCENTILES))
        room = 0.1 * (high - low)
        picture = oblique(np.clip(relief, low - room, high + room) / pixel, hillshade(relief, pixel))
        rows = np.nonzero(picture[..., 1].any(1))[0]
        picture = picture[rows[0] : rows[-1] + 1]
        drawing = new_drawing(WIDTH_IN, WIDTH_IN * picture.shape[0] / picture.shape[1])
        axes = drawing.add_axes((0, 0, 1, 1))
        axes.imshow(np.where(picture[..., 1:] > 0, picture[..., :1], 255).repeat(3, 2), interpolation="antialiased")
        axes.set_axis_off()
        yield plates.figure(
            f"view_{name}", f"{title}, from below",
            f"The surface tilted back by {_TILT_DEG:.0f}°, light from the upper left.",
            drawing, ["surface", "tilt_deg", "relief_p0.2", "relief_p99.8", "unit"],
            [[name, _TILT_DEG, low, high, "GSD" if name == "polarization" else plates.unit]],
        )  # fmt: skip
