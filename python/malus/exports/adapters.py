"""Formats whose writers are modules of their own (malus.drawings, colmap_export, rti, iiif, archive): what they are given."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from malus import archive, drawings
from malus._files import write_text
from malus.colmap_export import write_colmap_workspace
from malus.errors import InputError
from malus.exports.exporter import Exporter, Wishes
from malus.iiif import write_iiif
from malus.relief import flattened, gray, hillshade
from malus.rti import write_relight, write_rti


def export_contours(exporter: Exporter, path: Path) -> None:
    """Contour lines of the elevation, as SVG or DXF."""
    _write_drawing(path, drawings.contours(exporter.dem(), exporter.wishes.interval), exporter, "contour lines")


def export_sections(exporter: Exporter, path: Path) -> None:
    """Prior and fused surface along every profile, as SVG or DXF; InputError without profiles."""
    profiles = exporter.workspace.quality["profiles"]
    if not profiles:
        raise InputError(f"{path}: the station file has no [[profile]], along which to cut")
    sections = [
        [
            drawings.Layer(f"{profile['name']} {surface}", drawings.section(profile["position"], profile[surface]))
            for surface in ("prior", "fused")
            if profile[surface]
        ]
        for profile in profiles
    ]
    drawings.set_apart(sections)
    _write_drawing(path, [layer for section in sections for layer in section], exporter, "sections")


def _write_drawing(path: Path, layers: list[drawings.Layer], exporter: Exporter, title: str) -> None:
    if path.suffix.lower() == ".dxf":
        drawings.write_dxf(path, layers, exporter.unit, exporter.said)
    else:
        drawings.write_svg(path, layers, exporter.unit, f"{exporter.name}: {title}", "\n".join(exporter.words()))


def export_colmap(exporter: Exporter, path: Path) -> None:
    """A dense workspace of COLMAP."""
    write_colmap_workspace(exporter.workspace, exporter.picture(), exporter.xmp(), path)


def export_rti(exporter: Exporter, path: Path) -> None:
    """A polynomial texture map."""
    write_rti(exporter.workspace, path)
    # The PTM format has no field for text.
    write_text(path.with_suffix(".ptm.txt"), "".join(f"{line}\n" for line in exporter.words()))


def export_relight(exporter: Exporter, path: Path) -> None:
    """A folder for OpenLIME and RelightLab."""
    write_relight(exporter.workspace, path, exporter.said, exporter.xmp())


def export_iiif(exporter: Exporter, path: Path) -> None:
    """A folder for IIIF viewers: photograph, relief and, if it is known, albedo."""
    gsd = float(exporter.workspace.quality["gsd"])
    relief = gray(hillshade(flattened(exporter.surface.depth), gsd))[..., :1]
    pictures = {
        "photograph": ("Photograph, without polarized light", exporter.picture()),
        "relief": ("Relief, light from the upper left", np.repeat(relief, 3, axis=-1)),
    }
    if exporter.workspace.mirrored_share() is not None:
        own = Exporter(exporter.workspace, exporter.threads, Wishes(albedo=True, chart=exporter.wishes.chart))
        pictures["albedo"] = ("Color without highlights and shading", own.picture())
    write_iiif(
        path,
        pictures,
        address=exporter.wishes.url or "http://localhost:8000",
        name=exporter.name,
        words=exporter.catalog,
        summary=f"Surface from polarization and stereo, one pixel is {exporter.trust['pixel']}, "
        f"confidence {exporter.trust['confidence']}: {exporter.trust['detail']}.",
    )


def export_archive(exporter: Exporter, path: Path) -> None:
    """All results with their inputs as one ZIP file."""
    archive.write_archive(exporter.workspace.folder, path)
