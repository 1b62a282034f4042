"""The surface of a workspace for other programs: meshes, point clouds, elevation, maps for renderers.

Meshes and clouds are in the world frame and the station's unit, except GLB and E57, whose standards prescribe meters.
Maps (displacement, normal map) have the grid of the elevation model: the plane fitted to the object, seen along its normal.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

from malus import exported
from malus._files import UNTIL_LEFT_S, remove_unfinished, require_utf8, writing
from malus.chart import ColorCorrection
from malus.errors import InputError
from malus.exports import adapters, clouds, maps, meshes
from malus.exports.beside import BESIDE, files_beside
from malus.exports.exporter import Exporter, Wishes
from malus.threads import ALL_CORES
from malus.workspace import Workspace, WorkspaceGiver, folder_of

__all__ = ["BESIDE", "COLORED", "FORMATS", "MESHES", "Exporter", "Wishes", "export", "files_beside"]

Writer = Callable[[Exporter, Path], None]

#: For each format: its writer, its file name in WORK/export/ and the suffixes that an output path may have.
FORMATS: dict[str, tuple[Writer, str, tuple[str, ...]]] = {
    "obj": (meshes.export_obj, "surface.obj", (".obj",)),
    "ply": (meshes.export_ply, "surface.ply", (".ply",)),
    "glb": (meshes.export_glb, "surface.glb", (".glb",)),
    "normal-map": (maps.export_normal_map, "normal_map.png", (".png", ".tif", ".tiff", ".exr")),
    "displacement": (maps.export_displacement, "displacement.tif", (".tif", ".tiff", ".exr")),
    "dem": (maps.export_dem, "dem.tif", (".tif", ".tiff")),
    "las": (clouds.export_las, "surface.las", (".las", ".laz")),
    "e57": (clouds.export_e57, "surface.e57", (".e57",)),
    "xyz": (clouds.export_xyz, "surface.xyz", (".xyz", ".txt", ".asc")),
    "stl": (meshes.export_stl, "surface.stl", (".stl",)),
    "orthophoto": (maps.export_orthophoto, "orthophoto.png", (".png",)),
    "contours": (adapters.export_contours, "contours.svg", (".svg", ".dxf")),
    "sections": (adapters.export_sections, "sections.svg", (".svg", ".dxf")),
    "colmap": (adapters.export_colmap, "colmap", ("",)),
    "rti": (adapters.export_rti, "surface.ptm", (".ptm",)),
    "relight": (adapters.export_relight, "relight", ("",)),
    "iiif": (adapters.export_iiif, "iiif", ("",)),
    "archive": (adapters.export_archive, "archive.zip", (".zip",)),
}
#: The formats that have triangles.
MESHES = ("obj", "ply", "glb", "stl")
#: The formats that show either the photograph's color or the albedo; IIIF shows both.
COLORED = ("obj", "ply", "glb", "orthophoto", "las", "e57", "xyz", "colmap")


def export(
    work: str | Path | WorkspaceGiver,
    format: str,
    output: str | Path | None = None,
    *,
    faces: int | None = None,
    interval: float | None = None,
    y_up: bool = False,
    albedo: bool = False,
    chart: str | Path | None = None,
    url: str | None = None,
    trim: float | None = None,
    fill: bool = False,
    threads: int = ALL_CORES,
) -> Path:
    """Write the surface of a workspace or a result in one of FORMATS; returns the file's path.

    Without `output` the file is written to WORK/export/; a result in memory has no such folder and needs an `output`.

    - obj, ply, glb, stl: mesh with texture (obj, glb), vertex colors (ply) or neither (stl); at most `faces` triangles if given.
      glb: the catalog entries and the origin are in asset.extras; `y_up` turns a world whose z is up to glTF's convention.
    - normal-map: PNG or TIFF of 3 × 16 bits, OpenGL and Blender convention (red = right, green = up, blue = towards the
      viewer; 0 … 65535 for −1 … 1), or EXR of 3 floats in −1 … 1. displacement: float TIFF or EXR, elevation above the plane in the
      station's unit, 0 where there is none. dem: the elevation model as GeoTIFF; normal-map and displacement have its grid. orthophoto:
      the object's picture on that grid, PNG with a world file, transparent where there is no surface.
    - las: points with color, normal and standard deviation, station unit. e57: points with color and normal, meters.
      xyz: text with a line for each point: x y z, red green blue (0 to 255), normal, standard deviation, station unit.
    - contours (every `interval`, station unit; default: a round number) and sections (along every [[profile]]): SVG or DXF.
    - colmap: a dense workspace (folder) with depth and normal map of the station, for stereo_fusion and poisson_mesher.
    - rti: the object under any light direction, as a polynomial texture map for RTI viewers.
    - relight: the object under any light direction, as a folder for OpenLIME and RelightLab, with normals and color as layers.
    - iiif: photograph, relief and albedo as a folder for IIIF viewers; `url`: where it will be on the web.
    - archive: all results with their inputs and paradata, as an RO-Crate in a BagIt bag, one ZIP file (see malus.archive).

    albedo: colors are the object's own, without highlights and shading (malus.albedo), instead of those of the photograph. chart: file of
    `malus chart`, which converts the camera's colors to sRGB. trim: drops parts of meshes whose standard deviation exceeds this many GSD.
    fill: closes holes that the surface surrounds, in magenta because nothing was measured there. PNG images state their color space. All
    formats state the entries of [object], the unit, and how far the surface may be trusted. rti states them in a text file beside
    the map; STL has room for unit and trust only.

    Raises malus.InputError, DataError for the albedo of a surface without a reflection model, or ExternalError if the format needs
    a package that is not installed.
    """
    if format not in FORMATS:
        raise InputError(f"format {format!r}, expected one of {', '.join(FORMATS)}")
    for given, name, allowed in (
        (faces, "faces", MESHES),
        (interval, "interval", ("contours",)),
        (y_up, "y-up", ("glb",)),
        (albedo, "albedo", COLORED),
        (chart, "chart", (*COLORED, "iiif")),
        (url, "url", ("iiif",)),
        (trim, "trim", MESHES),
        (fill, "fill", MESHES),
    ):
        if given is not None and given is not False and format not in allowed:
            raise InputError(f"--{name} is for {', '.join(allowed)}, not for {format}")
    if trim is not None and not trim > 0:
        raise InputError(f"--trim {trim}, expected a positive standard deviation in GSD")
    if faces is not None and faces < 4:
        raise InputError(f"--faces {faces}, expected at least 4")
    write, name, endings = FORMATS[format]
    with folder_of(work, output, "a file") as folder:
        path = folder / "export" / name if output is None else Path(output)
        require_utf8(path)
        if path.suffix.lower() not in endings:
            raise InputError(
                f"{path}: ends in {path.suffix!r}, expected {' or '.join(endings) or 'a folder'} for {format}"
            )
        correction = None if chart is None else ColorCorrection.load(chart)
        wishes = Wishes(faces, interval, y_up, albedo, correction, url, trim, fill)
        exporter = Exporter(Workspace(folder), threads, wishes)
        with writing(path):
            remove_unfinished(path.parent, older_than_s=UNTIL_LEFT_S, start=path.stem)
            write(exporter, path)
            _keep_if_unchanged(path, exporter.workspace, files_beside(format, path))
            exported.note(exporter.workspace, path)
    return path


def _keep_if_unchanged(path: Path, workspace: Workspace, beside: list[Path]) -> None:
    """Remove the exported file and the files `beside` it if a run changed the workspace meanwhile: they could mix two surfaces."""
    try:
        workspace.require_unchanged()
    except InputError:
        if path.is_dir():
            shutil.rmtree(path)
        else:
            for file in (path, *beside):
                file.unlink()
        raise
