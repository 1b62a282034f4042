"""Maps on the grid of the elevation model: elevation, displacement, normals and the object's picture."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from malus import _core
from malus._extra import extra
from malus._files import replacing, write_text
from malus.errors import InputError
from malus.exports.exporter import Exporter
from malus.object import arrays
from malus.rti import normal_levels
from malus.units import METERS
from malus.xmp import save_png, tag_png, tag_tiff


def export_dem(exporter: Exporter, path: Path) -> None:
    """The elevation model of the workspace as GeoTIFF; InputError if the run left it out."""
    workspace = exporter.workspace
    if workspace.has("fused/surface.ply") and not workspace.has("fused/dem.tif"):
        said = [warning for warning in workspace.quality["warnings"] if "fused/dem.tif" in warning]
        raise InputError(f"{workspace.folder}: {said[0] if said else 'no fused/dem.tif'}")
    with replacing(path) as temporary:
        shutil.copyfile(workspace.path("fused/dem.tif"), temporary)
        tag_tiff(temporary, exporter.xmp())


def export_displacement(exporter: Exporter, path: Path) -> None:
    """Elevation above the fitted plane, as float TIFF or EXR."""
    # Renderers know no missing values: pixels without elevation get 0, the fitted plane.
    elevation = np.nan_to_num(exporter.dem().elevation)
    if path.suffix.lower() == ".exr":
        _write_exr(exporter, path, {"Y": elevation})
    else:
        with replacing(path) as temporary:
            _core.write_float_tiff(str(temporary), elevation)
            tag_tiff(temporary, exporter.xmp())


def export_normal_map(exporter: Exporter, path: Path) -> None:
    """Normals in the frame of the fitted plane, as PNG or TIFF of 16 bits, or EXR."""
    dem = exporter.dem()
    known = np.isfinite(dem.elevation)
    normals = np.zeros((*dem.elevation.shape, 3), np.float32)
    normals[..., 2] = 1
    frame = np.stack([dem.right, dem.up, dem.normal], -1)
    for rows in arrays.chunks(*known.shape):
        places = dem.points(rows)[known[rows]]
        normals[rows][known[rows]] = exporter.world_normals(places) @ frame
    if path.suffix.lower() == ".exr":
        _write_exr(exporter, path, {"RGB": normals})
        return
    is_png = path.suffix.lower() == ".png"
    write, tag = (_core.write_png16, tag_png) if is_png else (_core.write_tiff16, tag_tiff)
    with replacing(path) as temporary:
        write(str(temporary), normal_levels(normals))
        tag(temporary, exporter.xmp())


def _write_exr(exporter: Exporter, path: Path, channels: dict[str, NDArray[np.float32]]) -> None:
    library = extra("OpenEXR", "OpenEXR", f"{path}: EXR")
    header = {"compression": library.ZIP_COMPRESSION, "type": library.scanlineimage, **exporter.said}
    with replacing(path) as temporary, library.File(header, channels) as file:
        file.write(str(temporary))


def export_orthophoto(exporter: Exporter, path: Path) -> None:
    """The object's picture as PNG, with a world file beside it."""
    dem = exporter.dem()
    known = np.isfinite(dem.elevation)
    picture = np.zeros((*dem.elevation.shape, 4), np.uint8)
    # In parts, because places and colors of all pixels of 100 megapixels would take tens of GB.
    for rows in arrays.chunks(*known.shape):
        places = dem.points(rows)[known[rows]]
        picture[rows][known[rows], :3] = exporter.colors(places)
    picture[known, 3] = 255
    per_meter = 1 / (dem.pixel * METERS[exporter.unit])
    save_png(path, picture, exporter.xmp(), dpi=per_meter * 0.0254)
    # World file: pixel size and the center of the first pixel, in the elevation model's own coordinates.
    write_text(path.with_suffix(".pgw"), f"{dem.pixel:.12g}\n0\n0\n{-dem.pixel:.12g}\n0\n0\n")
