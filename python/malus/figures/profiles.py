"""Where the profiles run, and sections along them with their detail."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus.columns import number as readable
from malus.figures.drawing import LETTERS_PT, WIDTH_IN, few_ticks, names_in_picture, new_drawing, style, tag
from malus.figures.figure import Figure
from malus.figures.plates import COLORS, Plates
from malus.lengths import shown
from malus.units import METERS


def profile_lines(plates: Plates) -> Figure:
    """The lines of the sections on the unpolarized image (Fig. 11)."""
    drawing, axes = plates.on_image()
    rows = []
    called, said = names_in_picture([profile["name"] for profile in plates.quality["profiles"]])
    for profile, name in zip(plates.quality["profiles"], called, strict=True):
        (u0, v0), (u1, v1) = profile["from_px"], profile["to_px"]
        rows.append([profile["name"], u0, v0, u1, v1])
        line = np.array([[u0, v0], [u1, v1]]) / plates.step
        axes.plot(*line.T, color="white", lw=3, solid_capstyle="round")
        axes.plot(*line.T, color="#d1495b", lw=1.6, solid_capstyle="round")
        tag(axes, line[0], name)
    return plates.figure(
        "profile_lines", "Where the profiles run", "On the unpolarized image; the name stands at the start." + said,
        drawing, ["profile", "from_u_px", "from_v_px", "to_u_px", "to_v_px"], rows,
    )  # fmt: skip


def profiles(plates: Plates) -> Iterator[Figure]:
    """Sections through prior, polarization height and fused surface (Fig. 12 and 13), and the detail of prior and fused surface."""
    sigma_px = float(plates.workspace.manifest["options"]["assess"]["detail_sigma_px"])
    to_micrometers = 1e6 * METERS[plates.unit]
    for number, profile in enumerate(plates.quality["profiles"], 1):
        if not profile["position"]:  # The line lies beside the surface; a warning says so.
            continue
        drawing = new_drawing(WIDTH_IN, 6.2, "constrained")
        above, below = drawing.subplots(2, 1, sharex=True, height_ratios=(5, 4))
        along = numbers(profile["position"])
        present = [name for name in COLORS if any(height is not None for height in profile[name])]
        step = float(np.median(np.diff(along))) / plates.gsd if len(along) > 1 else 1.0
        details = {
            name: to_micrometers * without_form(numbers(profile[name]), sigma_px / max(step, 1e-9))
            for name in present
            if name != "polarization"
        }
        for axes, lines in ((above, {name: numbers(profile[name]) for name in present}), (below, details)):
            for name, values in lines.items():
                axes.plot(
                    along, values, color=COLORS[name], lw=1.6 if name == "fused" else 1.2, label=plates.words[name]
                )
            axes.margins(x=0.01)
            style(axes)
            axes.yaxis.set_major_locator(few_ticks(5))
        beyond = _cut_spikes(plates, below, along, details)
        above.set_ylabel(f"height [{plates.unit}]", fontsize=LETTERS_PT)
        above.legend(fontsize=LETTERS_PT, frameon=False, ncols=3, loc="lower left", bbox_to_anchor=(0, 1),
                     borderaxespad=0, columnspacing=1, handlelength=1.2)  # fmt: skip
        below.set_ylabel("detail [µm]", fontsize=LETTERS_PT)
        below.set_xlabel(f"along the profile [{plates.unit}]", fontsize=LETTERS_PT)
        columns = [profile["position"], *(profile[name] for name in present), *details.values()]
        spread = ", ".join(
            f"{plates.words[name]} {readable(float(np.nanstd(values)), 2)} µm" for name, values in details.items()
        )
        called = [plates.words[name] for name in present]
        yield plates.figure(
            f"profile_{number}", f"Profile {profile['name']}",
            f"Above: height over the chord of the section of {plates.words['fused']}, towards the camera; polarization alone has "
            f"no absolute height. Below: what is finer than {sigma_px:g} px ({shown(sigma_px * plates.gsd, plates.unit)}), its form taken out"
            + ("." if not beyond else f"; cut off at the triangles, where {', '.join(beyond)}."),
            drawing,
            [f"position_{plates.unit}", *(f"{word}_{plates.unit}" for word in called), *(f"{plates.words[name]}_detail_um" for name in details)],
            list(zip(*columns, strict=True)), f"A section of {readable(float(along[-1]) if len(along) else 0)} {plates.unit}. Spread of the detail: {spread}.",
        )  # fmt: skip


def _cut_spikes(
    plates: Plates, axes: Any, along: NDArray[np.float64], lines: Mapping[str, NDArray[np.float64]]
) -> list[str]:
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
                f"{plates.words[name]} reaches from {readable(float(known.min()), 2)} to {readable(float(known.max()), 2)} µm"
            )
    return said


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
