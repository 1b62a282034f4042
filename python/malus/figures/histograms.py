"""Histograms of distances: to fitted planes of patches, to the reference."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from malus.columns import number as readable
from malus.figures.drawing import LETTERS_PT, WIDTH_IN, few_ticks, new_drawing, style
from malus.figures.figure import Figure
from malus.figures.plates import COLORS, Plates

#: Largest length of a histogram's axis, as a multiple of the range of the narrowest histogram.
_WIDEST = 5.0


def reference(plates: Plates) -> Iterator[Figure]:
    """Signed distances to the reference, and their histogram."""
    if plates.quality["reference"] and plates.workspace.has("fused/reference_distance.tif"):
        yield from _distances(plates, "reference", "Distance to the reference", plates.quality["reference"])


def m3c2(plates: Plates) -> Iterator[Figure]:
    """Signed M3C2 distances to the reference, and their histogram."""
    if plates.workspace.m3c2 and plates.workspace.has("fused/m3c2_distance.tif"):
        yield from _distances(plates, "m3c2", "M3C2 distance to the reference", plates.workspace.m3c2)


def _distances(plates: Plates, name: str, title: str, figures: Mapping[str, Any]) -> Iterator[Figure]:
    raster = plates.raster(f"fused/{name}_distance.tif") / np.float32(plates.gsd)
    caption = "Positive (blue): the surface lies in front of the reference."
    yield plates.signed_map(f"{name}_distance", title, caption, raster, "GSD")
    yield _histogram(
        plates, f"{name}_histogram", f"{title}, histogram", "distance [GSD]", {"fused": figures["histogram_gsd"]}, {}
    )


def _histogram(
    plates: Plates, name: str, title: str, axis: str, bins: Mapping[str, Mapping[str, Any]], notes: Mapping[str, str]
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
            beyond.append(f"{plates.words[surface]} {readable(100 * (total - inside) / total, 2)} %")
        classes.append(f"{readable(histogram['bin_width'], 2)} ({plates.words[surface]})")
        axes.stairs(
            100 * counts / max(total, 1) * width / histogram["bin_width"], edges, color=COLORS[surface], lw=1.5,
            fill=surface == "fused", alpha=0.85 if surface == "fused" else 1, label=notes.get(surface),
            zorder=2 if surface == "fused" else 3,
        )  # fmt: skip
    axes.set_xlim(low - 0.05 * (high - low), high + 0.05 * (high - low))
    axes.set_xlabel(axis, fontsize=LETTERS_PT)
    axes.set_ylabel(f"share of pixels in {readable(width, 2)} GSD [%]", fontsize=LETTERS_PT)
    style(axes)
    axes.xaxis.set_major_locator(few_ticks(6))
    if notes:
        axes.legend(fontsize=LETTERS_PT, frameon=False, loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0)
    rows = [
        [
            plates.words[surface],
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
    return plates.figure(name, title, caption, drawing, header, rows)


def patches(plates: Plates) -> Iterator[Figure]:
    """Distances of flat patches to their fitted planes (Fig. 15)."""
    for number, patch in enumerate(plates.quality["patches"], 1):
        fits = {name: patch[name] for name in COLORS if patch[name] is not None}
        if fits:
            yield _histogram(
                plates,
                f"patch_{number}",
                f"Patch {patch['name']}",
                "distance to the fitted plane [GSD]",
                {name: fit["histogram_gsd"] for name, fit in fits.items()},
                {name: f"{plates.words[name]}: RMSE {readable(fit['rmse_gsd'])} GSD" for name, fit in fits.items()},
            )


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
