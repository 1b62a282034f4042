"""What the export formats need from a workspace: mesh, point cloud, elevation model, colors and texts."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from malus import _core
from malus._extra import extra
from malus.albedo import albedo_of
from malus.chart import ColorCorrection
from malus.errors import InputError
from malus.raster import sample, sample_known
from malus.repair import FILLED_COLOR, filled, trimmed
from malus.surface import Dem, Mesh, dem_from_mesh, mesh_from_depth
from malus.threads import ALL_CORES
from malus.trust import said_of, words_of
from malus.workspace import Raster, Workspace
from malus.xmp import packet


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

    def texture(self) -> NDArray[np.uint8]:
        """`picture` for a mesh. Pixels without a color, such as those beside the object in gray images with a mask, get colors from near them."""
        color = self.color
        known = np.isfinite(color if color.ndim == 2 else color[..., 0])
        if self.filled is not None:
            known |= self.filled
        return _core.filled_beside(self.picture(), known.astype(np.uint8))

    @cached_property
    def _weighted_picture(self) -> NDArray[np.uint8]:
        """`picture` with 255 as the fourth channel, H×W×4; 0 in all channels where there is no surface."""
        known = np.isfinite(self.surface.depth)
        return np.dstack([self.picture(), np.where(known, np.uint8(255), np.uint8(0))]) * known[..., None]

    def colors(self, points: NDArray[np.float64]) -> NDArray[np.uint8]:
        """The object's color at world points (N×3) of the surface, sRGB, N×3: the mean of the pixels around that are on the surface.
        Those beside it have the color of something else, or none, which would darken the rim.
        """
        pixels = self.pixels(points)
        seen = sample(self._weighted_picture, pixels)
        weight = seen[:, 3:]
        colors = seen[:, :3] * (255 / np.maximum(weight, 1))
        beside = weight[:, 0] < 1  # a vertex that simplification has moved beside the surface
        colors[beside] = sample(self.picture(), pixels[beside])
        return np.rint(colors).astype(np.uint8)

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
        return replace(mesh, colors=self.colors(mesh.vertices))

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
        return Mesh(points, self.world_normals(points), self.colors(points), triangles.astype(np.uint32))

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
