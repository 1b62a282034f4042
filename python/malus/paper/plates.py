"""The paper's figures that the report's sections do not have: sinusoids, the cloud, patches, oblique views, sections' detail."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure as Drawing
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from malus.figures import COLORS, Figure, Plates, flattened, grey, hillshade, numbers, style
from malus.units import METRES
from malus.workspace import Raster

#: Long side of the oblique views' data, and how far the object is tilted back in them.
_VIEW_PX, _TILT_DEG = 700, 50.0
#: Points drawn at most, evenly chosen.
_MOST_POINTS = 40_000
_CURVE_COLORS = ("#2f7fb3", "#35a7a0", "#b0702a", "#d1495b")


def sinusoids(plates: Plates) -> Iterator[Figure]:
    """Intensity against the polarizer's angle at a few pixels, with the fitted sinusoids (Fig. 1c)."""
    curves = plates.workspace.manifest["steps"]["polarization"]["notes"].get("curves")
    if not curves:
        return
    maps = {
        name: plates.workspace.raster(f"polarization/measured/{name}.tif")
        for name in ("unpolarized", "degree", "phase")
    }
    drawing = Drawing(figsize=(6.4, 3.6), layout="constrained")
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
        axes.plot(turned, curve["intensities"], "o", ms=4, color=color, label=f"({u}, {v}): ρ {degree:.3f}")
        rows += [
            [u, v, angle, intensity, float(fitted(angle)), degree, float(np.degrees(phase))]
            for angle, intensity in zip(curve["angles_deg"], curve["intensities"], strict=True)
        ]
    axes.set_xlabel("polarizer angle [°]", fontsize=9)
    axes.set_ylabel("intensity [of white]", fontsize=9)
    axes.set_xticks(range(0, 181, 30))
    axes.legend(fontsize=8, frameon=False, title="pixel", title_fontsize=8)
    style(axes)
    yield plates.figure(
        "sinusoids", "Intensity against polarizer angle",
        "Measured intensities (dots) of a weakly, a moderately and two strongly polarized pixels, and the sinusoid fitted "
        "to each.",
        drawing, ["u_px", "v_px", "angle_deg", "intensity", "fitted", "degree", "phase_deg"], rows,
    )  # fmt: skip


def cloud(plates: Plates) -> Iterator[Figure]:
    """The prior's cloud over the image it is projected into (Fig. 9)."""
    if not plates.workspace.has("prior/points.png"):
        return
    points = plates.workspace.raster("prior/points.png")
    depth = plates.workspace.raster("prior/depth.tif")
    drawing, axes = plates.on_image()
    on, off = points > 200, (points > 0) & (points <= 200)
    counts = [int(on.sum()), int(off.sum())]
    for which in (off, on):
        v, u = np.nonzero(which)
        chosen = slice(None, None, max(1, -(-len(u) // _MOST_POINTS)))
        u, v = u[chosen], v[chosen]
        look: dict[str, Any] = {"c": depth[v, u], "cmap": "viridis_r"} if which is on else {"c": "#d1495b"}
        axes.scatter(u / plates.step, v / plates.step, s=1.2, marker=".", linewidths=0, rasterized=True, **look)
    yield plates.figure(
        "cloud", "Cloud in the station's view",
        "Points of the cloud, projected into the unpolarized image: on the surface, by depth (bright is near), and red those "
        "behind it or off it.",
        drawing, ["points", "pixels"], [["on the surface", counts[0]], ["behind or off", counts[1]]],
    )  # fmt: skip


def patch_boxes(plates: Plates) -> Iterator[Figure]:
    """Flat patches on the image (Fig. 14)."""
    if not plates.quality["patches"]:
        return
    drawing, axes = plates.on_image()
    rows = []
    for patch in plates.quality["patches"]:
        u0, v0, u1, v1 = patch["box"]
        rows.append([patch["name"], u0, v0, u1, v1])
        corner = (u0 / plates.step - 0.5, v0 / plates.step - 0.5)
        size = ((u1 - u0 + 1) / plates.step, (v1 - v0 + 1) / plates.step)
        axes.add_patch(Rectangle(corner, *size, fill=False, ec="white", lw=3))
        axes.add_patch(Rectangle(corner, *size, fill=False, ec="#d1495b", lw=1.6))
        axes.annotate(
            patch["name"], corner, xytext=(0, 5), textcoords="offset points", color="white", fontsize=9,
            bbox={"boxstyle": "round,pad=0.2", "fc": "#d1495b", "ec": "none"},
        )  # fmt: skip
    yield plates.figure(
        "patch_boxes", "Flat patches", "Where the distances to planes are measured.",
        drawing, ["patch", "u0_px", "v0_px", "u1_px", "v1_px"], rows,
    )  # fmt: skip


def oblique(relief: Raster, shade: Raster, tilt_deg: float = _TILT_DEG) -> NDArray[np.uint8]:
    """A relief seen from below at an angle, gray with alpha: parallel rays, nearer parts hide farther ones.

    relief: H×W, in pixels, towards the viewer. Every pixel is drawn as a column down to its neighbor, so that slopes are closed.
    """
    sine, cosine = np.sin(np.radians(tilt_deg)), np.cos(np.radians(tilt_deg))
    rows = np.arange(relief.shape[0])[:, None] * cosine - relief * sine
    rows -= np.nanmin(rows)
    height = int(np.ceil(np.nanmax(rows))) + 2
    picture = np.full((height, relief.shape[1]), np.nan, np.float32)
    for v in range(relief.shape[0]):  # from the far side to the near one
        last = np.rint(rows[v])
        before = np.rint(rows[v - 1]) if v > 0 else last
        first = np.where(np.isfinite(before), np.minimum(before, last), last)
        for u in np.nonzero(np.isfinite(last))[0]:
            low, high = int(first[u]), int(last[u])
            if high - low > 60:  # a step: its wall is not seen
                low = high
            picture[low : high + 1, u] = shade[v, u]
    return grey(picture)


def views(plates: Plates) -> Iterator[Figure]:
    """Shaded oblique views of the three surfaces (Fig. 10)."""
    reliefs: dict[str, tuple[str, Raster, float]] = {}
    for name, title in (("prior", "Photogrammetry"), ("fused", "Fusion")):
        reliefs[name] = (title, plates.relief[name], plates.gsd * plates.step)
    if plates.quality["polarization_height"] is not None and plates.workspace.has("height/height.tif"):
        raster = plates.raster("height/height.tif")
        if np.isfinite(raster).any():
            reliefs["polarization"] = ("Polarization alone", flattened(-raster), float(plates.step))
    for name, (title, relief, pixel) in reliefs.items():
        stride = max(1, -(-max(relief.shape) // _VIEW_PX))
        thin = relief[::stride, ::stride]
        picture = oblique(thin / (pixel * stride), hillshade(relief, pixel)[::stride, ::stride])
        rows = np.nonzero(picture[..., 1].any(1))[0]
        picture = picture[rows[0] : rows[-1] + 1]
        width = 6.4
        drawing = Drawing(figsize=(width, width * picture.shape[0] / picture.shape[1]))
        axes = drawing.add_axes((0, 0, 1, 1))
        axes.imshow(np.where(picture[..., 1:] > 0, picture[..., :1], 255).repeat(3, 2), interpolation="antialiased")
        axes.set_axis_off()
        low, high = (float(p) for p in np.nanpercentile(relief, [0.5, 99.5]))
        yield plates.figure(
            f"view_{name}", f"{title}, from below",
            f"The surface tilted back by {_TILT_DEG:.0f}°, light from the upper left.",
            drawing, ["surface", "tilt_deg", "relief_p0.5", "relief_p99.5", "unit"],
            [[name, _TILT_DEG, low, high, "GSD" if name == "polarization" else plates.unit]],
        )  # fmt: skip


def high_pass(values: NDArray[np.float64], sigma: float) -> NDArray[np.float64]:
    """Values along a line minus their Gaussian mean over what is known; sigma in samples."""
    reach = int(np.ceil(3 * sigma))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    known = np.isfinite(values)
    weight = np.convolve(known.astype(float), kernel, "same")
    total = np.convolve(np.where(known, values, 0), kernel, "same")
    # "same" follows the longer of both: a line that is shorter than the kernel keeps its own length.
    start = (len(weight) - len(values)) // 2
    mean = (total / np.maximum(weight, 1e-12))[start : start + len(values)]
    return np.asarray(np.where(known, values - mean, np.nan))


def section_detail(plates: Plates) -> Iterator[Figure]:
    """Each section in full, and beside it its detail in micrometres (Fig. 12 and 13)."""
    micrometres = METRES[plates.unit] * 1e6
    sigma_px = float(plates.workspace.options().assess.detail_sigma_px)
    for number, profile in enumerate(plates.quality["profiles"], 1):
        yield _section(plates, number, profile, micrometres, sigma_px)


def _section(plates: Plates, number: int, profile: Mapping[str, Any], micrometres: float, sigma_px: float) -> Figure:
    drawing = Drawing(figsize=(9.6, 3.4), layout="constrained")
    full, detail = drawing.subplots(1, 2, width_ratios=(1, 1))
    along, along_px = numbers(profile["position"]), np.array(profile["position_px"], float)
    step_px = float(np.median(np.diff(along_px))) if len(along_px) > 1 else 1.0
    details: dict[str, NDArray[np.float64]] = {}
    for name in (name for name in COLORS if profile[name]):
        values = numbers(profile[name])
        details[name] = micrometres * high_pass(values, sigma_px / step_px)
        width = 1.3 if name == "fused" else 0.9
        full.plot(along, values, color=COLORS[name], lw=width, label=name)
        detail.plot(along, details[name], color=COLORS[name], lw=width)
    metric = [numbers(profile[name]) for name in ("prior", "fused") if profile[name]]
    if metric and np.isfinite(np.concatenate(metric)).any():
        # Height from polarization alone may be many times as large: it shall not flatten the others.
        low, high = np.nanmin(np.concatenate(metric)), np.nanmax(np.concatenate(metric))
        full.set_ylim(low - 0.4 * (high - low), high + 0.4 * (high - low))
        largest = max(np.nanpercentile(np.abs(details[name]), 99) for name in ("prior", "fused") if name in details)
        detail.set_ylim(-2 * largest, 2 * largest)
    full.set_ylabel(f"height [{plates.unit}]", fontsize=9)
    detail.set_ylabel("detail [µm]", fontsize=9)
    full.legend(fontsize=8, frameon=False, ncols=3, loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0)
    for axes in (full, detail):
        axes.set_xlabel(f"along the profile [{plates.unit}]", fontsize=9)
        style(axes)
    present = list(details)
    columns = [profile["position"], *(profile[name] for name in present), *(details[name].tolist() for name in present)]
    header = [
        f"position_{plates.unit}", *(f"{name}_{plates.unit}" for name in present), *(f"{name}_detail_um" for name in present)
    ]  # fmt: skip
    return plates.figure(
        f"section_{number}", f"Profile {profile['name']}, and its detail",
        f"Left the full section, right what is finer than a Gaussian of {sigma_px:g} px.",
        drawing, header, list(zip(*columns, strict=True)),
    )  # fmt: skip
