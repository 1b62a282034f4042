"""The surface of a workspace for other programs: meshes, point clouds, elevation, maps for renderers.

Meshes and clouds are in the world frame and the station's unit, except GLB and E57, whose standards prescribe meters.
Maps (displacement, normal map) have the grid of the elevation model: the plane fitted to the object, seen along its normal.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from malus import _core, archive, drawings, exported
from malus._extra import extra
from malus._files import UNTIL_LEFT_S, remove_unfinished, replacing, write_text, writing
from malus.albedo import albedo_of
from malus.chart import ColorCorrection
from malus.colmap_export import write_colmap_workspace
from malus.columns import number
from malus.e57_export import write_e57
from malus.errors import DataError, InputError
from malus.figures import flattened, gray, hillshade
from malus.iiif import write_iiif
from malus.lengths import shown
from malus.object import arrays, glb
from malus.raster import sample, sample_known
from malus.repair import FILLED_COLOR, filled, trimmed
from malus.rti import normal_levels, write_relight, write_rti
from malus.surface import Dem, Mesh, dem_from_mesh, mesh_from_depth
from malus.threads import ALL_CORES
from malus.trust import extras_of, said_of, words_of
from malus.units import METERS
from malus.workspace import Raster, Workspace, WorkspaceGiver, folder_of
from malus.xmp import packet, save_png, tag_png, tag_tiff

#: Largest rounding of a coordinate in an STL file: a tenth of a pixel is about what fusion adds to the coarse surface.
_MOST_ROUNDING_GSD = 0.1


@dataclass(frozen=True)
class Wishes:
    """Options of `export`.

    albedo: colors are the object's own, without highlights and shading, instead of those of the photograph.
    chart: converts the camera's colors to sRGB; without it the camera's colors are only brightened by `surface.white_percentile`.
    trim: pixels whose standard deviation exceeds this many GSD are left out. fill: holes are closed, in the color FILLED_COLOR.
    """

    faces: int | None = None
    interval: float | None = None
    y_up: bool = False
    albedo: bool = False
    chart: ColorCorrection | None = None
    url: str | None = None
    trim: float | None = None
    fill: bool = False


class Exporter:
    """Computes what the export formats need from a workspace: mesh, point cloud, elevation model, colors and texts."""

    def __init__(self, workspace: Workspace, threads: int = ALL_CORES, wishes: Wishes = Wishes()) -> None:
        self.workspace = workspace
        self.threads = threads
        self.wishes = wishes
        self.unit = str(workspace.quality["unit"])
        self.name = str(workspace.quality["name"])
        self.options = workspace.options()
        self.surface = workspace.surface()
        if wishes.trim is not None:
            self.surface = trimmed(self.surface, wishes.trim * float(workspace.quality["gsd"]))
        self.filled: NDArray[np.bool_] | None = None
        if wishes.fill:
            self.surface, self.filled = filled(self.surface)
        self.rotation, self.translation = workspace.pose

    @cached_property
    def color(self) -> Raster:
        """Linear color of the object, H×W or H×W×3: as photographed, without polarization, or its albedo."""
        return albedo_of(self.workspace) if self.wishes.albedo else self.workspace.color()

    def picture(self) -> NDArray[np.uint8]:
        """The object's color, sRGB, H×W×3."""
        picture = self._photograph()
        if self.filled is not None:
            picture = picture.copy()
            picture[self.filled] = FILLED_COLOR
        return picture

    def _photograph(self) -> NDArray[np.uint8]:
        color = self.color
        if self.wishes.chart is not None:
            if color.ndim != 3:
                raise InputError(f"{self.workspace.folder}: was taken in gray, a color chart is for a station in color")
            return self.wishes.chart.encoded(color)
        return _core.display_image(color, self.surface.depth, self.options.surface.white_percentile)

    def mesh(self) -> Mesh:
        """The surface at full size, as in fused/surface.ply."""
        mesh = mesh_from_depth(self.surface, color=self.color, options=self.options, threads=self.threads)
        if self.wishes.chart is None and self.filled is None:
            return mesh
        colors = np.rint(sample(self.picture(), self.pixels(mesh.vertices))).astype(np.uint8)
        return replace(mesh, colors=colors)

    @property
    def catalog(self) -> dict[str, str]:
        """The catalog entries of [object] in the station file."""
        return self.workspace.quality.get("object") or {}

    @cached_property
    def trust(self) -> dict[str, str]:
        """What every exported file states about the surface: unit, pixel size, confidence with its reasons, origin of the detail."""
        return words_of(self.workspace.quality)

    @cached_property
    def said(self) -> dict[str, str]:
        """`trust` and the catalog entries, one line each, for formats whose files have properties or a text header."""
        return said_of(self.workspace.quality)

    def words(self) -> list[str]:
        """`said` as lines: "title: Carved stone"."""
        return [f"{key}: {value}" for key, value in self.said.items()]

    def xmp(self) -> str:
        """`trust` and the catalog entries as an XMP packet, for image files."""
        return packet(self.name, self.catalog, self.trust)

    def pixels(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Where world points (…×3) are seen in the station's image, …×2."""
        camera = self.workspace.camera
        x, y, z = np.moveaxis(points @ self.rotation.T + self.translation, -1, 0)
        return np.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], -1)

    @cached_property
    def _known_normals(self) -> NDArray[np.float32]:
        """Fused normals, H×W×3, camera frame, 0 where none is known."""
        return np.nan_to_num(self.surface.normals)

    def world_normals(self, points: NDArray[np.float64]) -> NDArray[np.float32]:
        """Fused unit normals at world points (…×3) of the surface, world frame."""
        normal = sample(self._known_normals, self.pixels(points)) @ self.rotation
        length = np.linalg.norm(normal, axis=-1, keepdims=True)
        # Where no normal is known, use the direction towards the camera.
        unit: NDArray[np.float32] = np.where(length > 0.1, normal / np.maximum(length, 0.1), -self.rotation[2]).astype(
            np.float32
        )
        return unit

    def simplified(self) -> Mesh:
        """The surface with at most `wishes.faces` triangles (quadric error metric); normals and colors from the full rasters."""
        mesh, faces = self.mesh(), self.wishes.faces
        if faces is None or len(mesh.triangles) <= faces:
            return mesh
        library = extra("fast_simplification", "fast-simplification", "a mesh with fewer triangles (--faces)")
        # The library works in single precision, which suffices for coordinates relative to the middle.
        middle = mesh.vertices.mean(0)
        vertices, triangles = library.simplify(
            (mesh.vertices - middle).astype(np.float32), mesh.triangles.astype(np.int32), target_count=faces
        )
        points = np.asarray(vertices, dtype=np.float64) + middle
        colors = sample(self.picture(), self.pixels(points))
        return Mesh(points, self.world_normals(points), np.rint(colors).astype(np.uint8), triangles.astype(np.uint32))

    def texture_coordinates(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Place of world points in the texture, N×2: 0 … 1 from the left and from the bottom."""
        camera = self.workspace.camera
        pixels = self.pixels(points)
        return np.stack([(pixels[:, 0] + 0.5) / camera.width, 1 - (pixels[:, 1] + 0.5) / camera.height], -1)

    def dem(self) -> Dem:
        """Elevation above the plane fitted to the object."""
        return dem_from_mesh(self.mesh(), self.surface, options=self.options, threads=self.threads)

    @property
    def decimals(self) -> int:
        """Decimals of coordinates in text: to a thousandth of a pixel, also far from the origin, as in a national grid."""
        return max(0, 3 - int(np.floor(np.log10(float(self.workspace.quality["gsd"])))))

    def cloud(self) -> tuple[Mesh, NDArray[np.float64]]:
        """The surface's vertices (as a mesh) and their standard deviations of depth."""
        mesh = self.mesh()
        return mesh, sample_known(self.surface.sigma, self.pixels(mesh.vertices))


def _write_ply(exporter: Exporter, path: Path) -> None:
    mesh = exporter.simplified()
    _core.write_ply(
        str(path), mesh.vertices, mesh.normals, mesh.colors, mesh.triangles, exporter.words(), exporter.threads
    )


def _write_glb(exporter: Exporter, path: Path) -> None:
    mesh = exporter.simplified()
    workspace = exporter.workspace
    with replacing(path) as temporary:  # so that a model that is not turned yet never has the final name
        _core.write_glb(
            str(temporary), mesh.vertices, mesh.normals, mesh.triangles, exporter.picture(), workspace.camera, exporter.unit,
            exporter.name, extras_of(workspace.quality, workspace.manifest["versions"]), exporter.threads,
        )  # fmt: skip
        if exporter.wishes.y_up:
            _turn_y_up(temporary)


def _turn_y_up(path: Path) -> None:
    """Convert a GLB file of a world whose z is up to glTF's "y up": a new root node turns each scene by a quarter turn about x."""
    content = path.read_bytes()
    length = int.from_bytes(content[12:16], "little")
    document = json.loads(content[20 : 20 + length])
    half = float(np.sqrt(0.5))
    for scene in document["scenes"]:
        document["nodes"].append({"name": "y up", "rotation": [-half, 0, 0, half], "children": scene["nodes"]})
        scene["nodes"] = [len(document["nodes"]) - 1]
    path.write_bytes(glb.container(document, content[28 + length :]))


def _write_stl(exporter: Exporter, path: Path) -> None:
    mesh = exporter.simplified()
    _require_few_digits(exporter, mesh, path)
    with replacing(path) as temporary, temporary.open("wb") as file:
        # The header has only 80 bytes: the statements about trust come before the name. It must not begin with the name, which could
        # be "solid": that word marks a text STL.
        said = f"Malus, {exporter.unit}, confidence {exporter.trust['confidence']}, {exporter.trust['detail']}: {exporter.name}"
        file.write(said.encode("ascii", "replace")[:80].ljust(80))
        file.write(np.uint32(len(mesh.triangles)).tobytes())
        # In parts, because all facets of 100 megapixels would take many times the mesh's memory.
        for rows in arrays.chunks(len(mesh.triangles)):
            file.write(_facets(mesh.vertices[mesh.triangles[rows]]).tobytes())


def _facets(corners: NDArray[np.float64]) -> NDArray[np.void]:
    """Records of a binary STL file for triangles (N×3×3: their corners)."""
    facets = np.zeros(len(corners), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facets["normal"] = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    facets["corners"] = corners
    return facets


def _require_few_digits(exporter: Exporter, mesh: Mesh, path: Path) -> None:
    """DataError for a mesh so far from the origin that the 24 bits of STL's coordinates would tear it into steps."""
    farthest, gsd = float(np.abs(mesh.vertices).max()), float(exporter.workspace.quality["gsd"])
    rounding = farthest * 2.0**-24
    if rounding > _MOST_ROUNDING_GSD * gsd:
        raise DataError(
            f"{path}: its coordinates reach {farthest:.0f} {exporter.unit}, which STL rounds by {shown(rounding, exporter.unit)}, "
            f"{number(rounding / gsd, 2)} pixels on the object; expected a frame whose origin is near the object, or --format ply or glb"
        )


def _write_orthophoto(exporter: Exporter, path: Path) -> None:
    dem = exporter.dem()
    known = np.isfinite(dem.elevation)
    picture = np.zeros((*dem.elevation.shape, 4), np.uint8)
    photograph = exporter.picture()
    # In parts, because places and colors of all pixels of 100 megapixels would take tens of GB.
    for rows in arrays.chunks(*known.shape):
        places = dem.points(rows)[known[rows]]
        picture[rows][known[rows], :3] = np.rint(sample(photograph, exporter.pixels(places)))
    picture[known, 3] = 255
    per_meter = 1 / (dem.pixel * METERS[exporter.unit])
    save_png(path, picture, exporter.xmp(), dpi=per_meter * 0.0254)
    # World file: pixel size and the center of the first pixel, in the elevation model's own coordinates.
    write_text(path.with_suffix(".pgw"), f"{dem.pixel:.12g}\n0\n0\n{-dem.pixel:.12g}\n0\n0\n")


def _write_drawing(path: Path, layers: list[drawings.Layer], exporter: Exporter, title: str) -> None:
    if path.suffix.lower() == ".dxf":
        drawings.write_dxf(path, layers, exporter.unit, exporter.said)
    else:
        drawings.write_svg(path, layers, exporter.unit, f"{exporter.name}: {title}", "\n".join(exporter.words()))


def _write_contours(exporter: Exporter, path: Path) -> None:
    _write_drawing(path, drawings.contours(exporter.dem(), exporter.wishes.interval), exporter, "contour lines")


def _write_sections(exporter: Exporter, path: Path) -> None:
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


def _write_colmap(exporter: Exporter, path: Path) -> None:
    write_colmap_workspace(exporter.workspace, exporter.picture(), exporter.xmp(), path)


def _write_rti(exporter: Exporter, path: Path) -> None:
    write_rti(exporter.workspace, path)
    # The PTM format has no field for text.
    write_text(path.with_suffix(".ptm.txt"), "".join(f"{line}\n" for line in exporter.words()))


def _write_relight(exporter: Exporter, path: Path) -> None:
    write_relight(exporter.workspace, path, exporter.said, exporter.xmp())


def _write_iiif(exporter: Exporter, path: Path) -> None:
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


def _write_archive(exporter: Exporter, path: Path) -> None:
    archive.write_archive(exporter.workspace.folder, path)


def _write_obj(exporter: Exporter, path: Path) -> None:
    mesh = exporter.simplified()
    texture, material = files_beside("obj", path)
    save_png(texture, exporter.picture(), exporter.xmp())
    with replacing(material) as temporary:
        temporary.write_text(f"newmtl photograph\nKd 1 1 1\nKs 0 0 0\nmap_Kd {texture.name}\n", encoding="utf-8")
    with replacing(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        file.writelines(f"# {line}\n" for line in exporter.words())
        file.write(
            f"# {' '.join(exporter.name.split())}, lengths in {exporter.unit}, world frame\nmtllib {material.name}\n"
        )
        places = exporter.decimals
        # In parts, because copies of all rows of 100 megapixels would take many times the mesh's memory.
        for rows in arrays.chunks(len(mesh.vertices)):
            np.savetxt(file, mesh.vertices[rows], " ".join(["v", *[f"%.{places}f"] * 3]))
        for rows in arrays.chunks(len(mesh.vertices)):
            np.savetxt(file, exporter.texture_coordinates(mesh.vertices[rows]), "vt %.7f %.7f")
        for rows in arrays.chunks(len(mesh.vertices)):
            np.savetxt(file, mesh.normals[rows], "vn %.5f %.5f %.5f")
        file.write("usemtl photograph\n")
        for rows in arrays.chunks(len(mesh.triangles)):
            # Indices in OBJ files start at 1.
            corners = np.repeat(mesh.triangles[rows].astype(np.int64) + 1, 3, axis=1)
            np.savetxt(file, corners, "f %d/%d/%d %d/%d/%d %d/%d/%d")


def _write_dem(exporter: Exporter, path: Path) -> None:
    with replacing(path) as temporary:
        shutil.copyfile(exporter.workspace.path("fused/dem.tif"), temporary)
        tag_tiff(temporary, exporter.xmp())


def _write_exr(exporter: Exporter, path: Path, channels: dict[str, NDArray[np.float32]]) -> None:
    library = extra("OpenEXR", "OpenEXR", f"{path}: EXR")
    header = {"compression": library.ZIP_COMPRESSION, "type": library.scanlineimage, **exporter.said}
    with replacing(path) as temporary, library.File(header, channels) as file:
        file.write(str(temporary))


def _write_normal_map(exporter: Exporter, path: Path) -> None:
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


def _write_displacement(exporter: Exporter, path: Path) -> None:
    # Renderers know no missing values: pixels without elevation get 0, the fitted plane.
    elevation = np.nan_to_num(exporter.dem().elevation)
    if path.suffix.lower() == ".exr":
        _write_exr(exporter, path, {"Y": elevation})
    else:
        with replacing(path) as temporary:
            _core.write_float_tiff(str(temporary), elevation)
            tag_tiff(temporary, exporter.xmp())


def _write_las(exporter: Exporter, path: Path) -> None:
    library = extra("laspy", "laspy", f"{path}: LAS")
    if path.suffix.lower() == ".laz":
        extra("lazrs", "lazrs", f"{path}: LAZ")
    cloud, sigma = exporter.cloud()
    header = library.LasHeader(point_format=7, version="1.4")
    # The specification requires this bit with point formats 6 to 10; converters to COPC refuse files without it.
    header.global_encoding.wkt = True
    header.offsets = cloud.vertices.mean(0)
    # LAS stores whole numbers: steps of a thousandth of a pixel or finer.
    header.scales = np.full(3, 10.0 ** np.floor(np.log10(1e-3 * exporter.workspace.quality["gsd"])))
    for name in ("sigma", "normal_x", "normal_y", "normal_z"):
        header.add_extra_dim(library.ExtraBytesParams(name=name, type=np.float32))
    # The text record of the LAS specification, 65 535 bytes at most; a zero ends it.
    text = "\n".join(exporter.words()).encode()[:65534] + b"\0"
    header.vlrs.append(library.VLR("LASF_Spec", 3, "[object]", text))
    points = library.LasData(header)
    points.x, points.y, points.z = cloud.vertices.T
    # Each point is the first of one return: with 0 the header's numbers of points by return would be 0, too.
    points.return_number = np.ones(len(cloud.vertices), np.uint8)
    points.number_of_returns = np.ones(len(cloud.vertices), np.uint8)
    points.red, points.green, points.blue = cloud.colors.T.astype(np.uint16) * 257
    points.sigma = sigma.astype(np.float32)
    points.normal_x, points.normal_y, points.normal_z = cloud.normals.T
    with replacing(path) as temporary:
        points.write(str(temporary))


def _write_xyz(exporter: Exporter, path: Path) -> None:
    cloud, sigma = exporter.cloud()
    length = f"%.{exporter.decimals}f"
    with replacing(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        file.writelines(f"# {line}\n" for line in exporter.words())
        file.write("# x y z red green blue nx ny nz sigma\n")
        # In parts, because text of all rows of 100 megapixels would take many times the cloud's memory.
        for rows in arrays.chunks(len(cloud.vertices)):
            table = np.column_stack([cloud.vertices[rows], cloud.colors[rows], cloud.normals[rows], sigma[rows]])
            np.savetxt(file, table, " ".join([*[length] * 3, "%d %d %d", "%.5f %.5f %.5f", length]))


def _write_e57(exporter: Exporter, path: Path) -> None:
    cloud, _ = exporter.cloud()
    points = cloud.vertices * METERS[exporter.unit]
    # Floats of 32 bits are written. Far from the origin, as in a national grid, points are stored about their middle, which the scan's
    # pose adds to them; near it as they are, for readers that take no pose.
    largest, pixel = np.abs(points).max(), exporter.workspace.quality["gsd"] * METERS[exporter.unit]
    middle = points.mean(0) if largest * 2.0**-24 > 1e-3 * pixel else np.zeros(3)
    said = {**exporter.said, "unit": "m"}
    name = f"{exporter.name} (confidence {said['confidence']})"
    write_e57(path, points - middle, cloud.normals, cloud.colors, middle, name, said)


Writer = Callable[[Exporter, Path], None]

#: For each format: its writer, its file name in WORK/export/ and the suffixes that an output path may have.
FORMATS: dict[str, tuple[Writer, str, tuple[str, ...]]] = {
    "obj": (_write_obj, "surface.obj", (".obj",)),
    "ply": (_write_ply, "surface.ply", (".ply",)),
    "glb": (_write_glb, "surface.glb", (".glb",)),
    "normal-map": (_write_normal_map, "normal_map.png", (".png", ".tif", ".tiff", ".exr")),
    "displacement": (_write_displacement, "displacement.tif", (".tif", ".tiff", ".exr")),
    "dem": (_write_dem, "dem.tif", (".tif", ".tiff")),
    "las": (_write_las, "surface.las", (".las", ".laz")),
    "e57": (_write_e57, "surface.e57", (".e57",)),
    "xyz": (_write_xyz, "surface.xyz", (".xyz", ".txt", ".asc")),
    "stl": (_write_stl, "surface.stl", (".stl",)),
    "orthophoto": (_write_orthophoto, "orthophoto.png", (".png",)),
    "contours": (_write_contours, "contours.svg", (".svg", ".dxf")),
    "sections": (_write_sections, "sections.svg", (".svg", ".dxf")),
    "colmap": (_write_colmap, "colmap", ("",)),
    "rti": (_write_rti, "surface.ptm", (".ptm",)),
    "relight": (_write_relight, "relight", ("",)),
    "iiif": (_write_iiif, "iiif", ("",)),
    "archive": (_write_archive, "archive.zip", (".zip",)),
}
#: Suffixes of further files that a format leaves beside the file it is asked for.
BESIDE = {"obj": (".png", ".mtl"), "orthophoto": (".pgw",), "rti": (".ptm.txt",)}


def files_beside(format: str, path: Path) -> list[Path]:
    """The further files that a format leaves beside `path`; in those of an OBJ, whose text names them, "_" replaces spaces, which end a name."""
    name = "_".join(path.name.split()) if format == "obj" else path.name
    return [path.with_name(name).with_suffix(suffix) for suffix in BESIDE.get(format, ())]


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
        if given and format not in allowed:
            raise InputError(f"--{name} is for {', '.join(allowed)}, not for {format}")
    if trim is not None and not trim > 0:
        raise InputError(f"--trim {trim}, expected a positive standard deviation in GSD")
    if faces is not None and faces < 4:
        raise InputError(f"--faces {faces}, expected at least 4")
    write, name, endings = FORMATS[format]
    with folder_of(work, output, "a file") as folder:
        path = folder / "export" / name if output is None else Path(output)
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
