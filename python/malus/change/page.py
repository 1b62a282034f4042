"""The page of a comparison: both surfaces with a movable edge between them, maps of distances and significant changes, changed parts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from malus import _core
from malus.change.regions import Region
from malus.change.significance import Distances, reduced_maps
from malus.columns import plain, printed
from malus.exports.exporter import Exporter
from malus.figures import Figure, Plates
from malus.lengths import scale_bar, shown
from malus.pages import template
from malus.pictures import encode
from malus.relief import flattened, gray, hillshade
from malus.units import METERS


def _maps(plates: Plates, distances: Distances, regions: list[Region], um: float) -> list[Figure]:
    every, significant = (values * um for values in reduced_maps(distances, plates.step))
    labels = [(region.u / plates.step, region.v / plates.step, str(region.number)) for region in regions[:30]]
    return [
        plates.signed_map(
            "distance",
            "Distance of the later surface from the earlier one",
            "Along the earlier surface's normal. Positive (blue): in front of it, material was added; negative (red): it was lost.",
            every,
            "µm",
        ),
        plates.signed_map(
            "significant",
            "Significant changes",
            "The same where it is larger than the smallest detectable change (95 %), over the earlier relief; the numbers are those "
            "of the table.",
            significant,
            "µm",
            shade=plates.shade("fused"),
            labels=labels,
        ),
        plates.map(
            "limit",
            "Smallest detectable change",
            "A smaller one may be measurement error alone (95 %).",
            plates.small(distances.limit) * um,
            "viridis",
            "µm",
        ),
    ]


def _date(identity: dict[str, Any]) -> str:
    """The date when a surface was recorded, or the name of its workspace folder if no date is stated."""
    return str(identity["recorded_on"] or Path(identity["workspace"]).name)


def write_page(
    folder: Path,
    before: Exporter,
    distances: Distances,
    regions: list[Region],
    figures: dict[str, Any],
) -> Path:
    """Write index.html (self-contained) and figures/ with every figure as PNG and its numbers as CSV; returns the page's path."""
    plates = Plates(before.workspace)
    drawn = _maps(plates, distances, regions, METERS[before.unit] * 1e6)
    (folder / "figures").mkdir()
    for figure in drawn:
        (folder / f"figures/{figure.name}.png").write_bytes(figure.png())
        (folder / f"figures/{figure.name}.csv").write_text(figure.csv(), encoding="utf-8")
    pixel = plates.gsd * plates.step
    box = plates.object_box()
    shades = [hillshade(flattened(plates.small(d)), pixel) for d in (before.surface.depth, distances.depth_after)]
    height, width = shades[0][box].shape[:2]
    length, bar_label = scale_bar(width * pixel, before.unit)
    page = template(
        "change.html.j2",
        {"micrometers": lambda um, digits=2: shown(um, "um", digits), "plain": plain, "printed": printed},
    ).render(
        figures=figures,
        dates=[_date(figures[which]) for which in ("before", "after")],
        aspect=width / height,
        bar_percent=100 * length / (width * pixel),
        bar_label=bar_label,
        plates=drawn,
        pictures=[encode(gray(shade)[box], "WEBP", quality=90) for shade in shades],
        version=_core.version,
    )
    path = folder / "index.html"
    path.write_text(page, encoding="utf-8")
    return path
