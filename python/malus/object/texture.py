"""The mesh for viewers: fewer triangles, and a texture atlas (xatlas) with baked color and full-resolution normals."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus._extra import extra
from malus.chart import srgb_bytes
from malus.object.arrays import CHUNK, chunks
from malus.object.color import Paint
from malus.object.meshing import ObjectMesh, face_normals, sums_at_vertices, vertex_normals
from malus.object.views import Floats, scipy, unit

#: Texels per GSD (of the cells where the mesh's lattice is finer), and the longest side of the texture.
_TEXELS_PER_GSD = 1.5
_MOST_SIDE = 8192
#: Width of the margin of empty texels about a chart that take the border's values, so that filtering shows no seam.
_MARGIN_PX = 4
#: Samples that lie outside of a triangle by no more than this (in samples) are on its edge.
_ON_EDGE = 1e-9
#: Most levels of detail, and fewest triangles of a level.
_MOST_LEVELS = 5
_LEAST_FACES = 500
#: Most vertices of a mesh that is searched with one tree in memory; and number of parts across into which places on a larger mesh are
#: sorted.
_MOST_IN_MEMORY, _PARTS_ACROSS = 4_000_000, 16
#: The vertices of a large mesh are sorted into so many cells across.
_CELLS_ACROSS = 64


@dataclass(frozen=True)
class TexturedMesh:
    """vertices, normals: N×3, world, station unit. tangents: N×4 (glTF). uv: N×2, from the top left. triangles: M×3.

    color, normal_map: H×W×3, 8 bit; the normal map in the tangent frame, OpenGL convention. deviation: RMS distance from the full mesh.
    albedo: like color, without highlights and shading; None if it is not known.
    """

    vertices: Floats
    normals: Floats
    tangents: Floats
    uv: Floats
    triangles: NDArray[np.int64]
    color: NDArray[np.uint8]
    normal_map: NDArray[np.uint8]
    deviation: float
    albedo: NDArray[np.uint8] | None = None


def require_packages() -> None:
    """Raise ExternalError if a package that objects need is missing."""
    for module, package in (
        ("scipy", "scipy"),
        ("xatlas", "xatlas"),
        ("fast_simplification", "fast-simplification"),
        ("skimage", "scikit-image"),
    ):
        extra(module, package, "the surface of an object", "object")


def textured(
    mesh: ObjectMesh,
    faces: int,
    paint: Paint,
    gsd: float,
    *,
    simpler: ObjectMesh | None = None,
    coarseness: int = 1,
    albedo: Paint | None = None,
) -> TexturedMesh:
    """The mesh with about `faces` triangles at most, and color and normals of the full mesh baked into its texture.

    simpler: the same surface with fewer triangles, to simplify from. coarseness: factor on the usual side of a texel; texels hold means.
    albedo: is baked into a texture of its own.
    """
    low = mesh if simpler is None else simpler
    middle = low.vertices.mean(0)
    # In GSD: both libraries take lengths and areas below certain limits for zero, and a mesh in meters is below these limits.
    points, triangles = (low.vertices - middle) / gsd, np.asarray(low.triangles)
    if len(triangles) > faces:
        library = extra("fast_simplification", "fast-simplification", "the texture of an object", "object")
        points, triangles = library.simplify(points.astype(np.float32), triangles.astype(np.int32), target_count=faces)
        points = points.astype(np.float64)
    levels = _levels(mesh, gsd * points[triangles].mean(1) + middle)
    side, original, triangles, uv = _atlas(points, triangles, levels, coarseness)
    normals = vertex_normals(points, original[triangles])[original]
    points = gsd * points[original] + middle
    tangents = _tangents(points, normals, uv, triangles)
    color, fine, bare = (np.zeros((side, side, 3), np.uint8) for _ in range(3))
    flat = TexturedMesh(points, normals, tangents, uv, triangles, color, fine, 0.0, None if albedo is None else bare)
    return _baked(flat, mesh, [paint] if albedo is None else [paint, albedo], coarseness)


def levels_of_detail(
    mesh: ObjectMesh,
    faces: int,
    paint: Paint,
    gsd: float,
    simpler: ObjectMesh | None = None,
    albedo: Paint | None = None,
) -> list[TexturedMesh]:
    """The textured mesh and simpler levels, each with a quarter of the triangles and half the texture side of the level before it.

    Only the first level has the albedo.
    """
    levels: list[TexturedMesh] = []
    most = min(faces, len((mesh if simpler is None else simpler).triangles))
    for level in range(_MOST_LEVELS):
        wanted = most // 4**level
        if level and (wanted < _LEAST_FACES or wanted >= len(levels[-1].triangles)):
            break
        bare = None if level else albedo
        levels.append(textured(mesh, wanted, paint, gsd, simpler=simpler, coarseness=2**level, albedo=bare))
    return levels


def _baked(flat: TexturedMesh, full: ObjectMesh, paints: Sequence[Paint], coarseness: int) -> TexturedMesh:
    """Bake color, normals and distance of the full mesh, some triangles at a time. paints: for color, and for the albedo if `flat` has one."""
    side = len(flat.color)
    painted = [flat.color] if flat.albedo is None else [flat.color, flat.albedo]
    find = NearestVertices(full)
    covered = np.zeros((side, side), bool)
    away = []
    corners = flat.vertices[flat.triangles]
    for region in find.regions(corners.mean(1)):
        nearest_to = find.about(corners[region].reshape(-1, 3))
        for some in _in_portions(flat, region, coarseness):
            triangles = flat.triangles[some]
            rows, columns, owner, shares = _texels(flat.uv * side, triangles, side, coarseness)
            if not len(owner):
                continue
            places = (shares[..., None] * corners[some[owner]]).sum(1)
            nearest = nearest_to(places)
            near, near_normals = full.vertices[nearest], full.normals[nearest]
            away.append(np.abs(((places - near) * near_normals).sum(1)))
            frame, along = (
                (shares[..., None] * values[triangles[owner]]).sum(1) for values in (flat.normals, flat.tangents[:, :3])
            )
            texel, where = np.unique(rows * side + columns, return_inverse=True)
            fine = _tangent_space(near_normals, frame, along, flat.tangents[triangles[owner, 0], 3])
            local = unit(_means(where, fine, len(texel)))
            at = np.unravel_index(texel, (side, side))
            flat.normal_map[at] = np.rint((local + 1) * 127.5).astype(np.uint8)
            for image, paint in zip(painted, paints, strict=True):
                image[at] = srgb_bytes(_means(where, paint.linear(near, near_normals), len(texel)))
            covered[at] = True
    _grow(covered, (*painted, flat.normal_map))
    return replace(flat, deviation=float(np.sqrt((np.concatenate(away) ** 2).mean())))


def _in_portions(flat: TexturedMesh, some: NDArray[np.int64], finer: int) -> list[NDArray[np.int64]]:
    """These triangles in portions of about CHUNK samples. Neighbors come together, so that few vertices of the full mesh are read at a time."""
    texels = 64 * np.ptp(flat.vertices, axis=0).max() / len(flat.color)
    order = some[np.lexsort(np.floor(flat.vertices[flat.triangles[some, 0]] / texels).T)]
    corners = flat.uv[flat.triangles[order]] * len(flat.color) * finer
    boxes = (np.ptp(corners, axis=1) + 1).prod(1)
    return np.split(order, np.flatnonzero(np.diff(np.cumsum(boxes) // CHUNK)) + 1)


def _means(where: NDArray[np.int64], values: Floats, count: int) -> Floats:
    """Means (count×3) of the values (N×3) that have the same index in `where` (N)."""
    number = np.maximum(np.bincount(where, minlength=count), 1)
    return np.stack([np.bincount(where, values[:, k], count) / number for k in range(3)], 1)


class NearestVertices:
    """Finds the vertex of a mesh that is nearest to each place. Of a large mesh, only the vertices about the places are in memory."""

    def __init__(self, mesh: ObjectMesh) -> None:
        self._mesh = mesh
        self._whole = self._among(np.arange(len(mesh.vertices))) if len(mesh.vertices) <= _MOST_IN_MEMORY else None
        if self._whole is None:
            self._sort_into_cells()

    def _sort_into_cells(self) -> None:
        vertices = self._mesh.vertices
        low, high = vertices.min(0), vertices.max(0)
        self._low, self._cell = low, float((high - low).max()) / _CELLS_ACROSS
        cells = np.empty(len(vertices), np.int32)
        for rows in chunks(len(vertices)):
            cells[rows] = self._number(self._cell_of(vertices[rows]))
        self._sorted: NDArray[np.int64] = np.argsort(cells, kind="stable")
        numbers, starts = np.unique(cells[self._sorted], return_index=True)
        ends = [*starts[1:].tolist(), len(cells)]
        self._rows = {
            number: slice(*ends_) for number, *ends_ in zip(numbers.tolist(), starts.tolist(), ends, strict=True)
        }

    def _cell_of(self, places: Floats) -> NDArray[np.int64]:
        return np.asarray(np.clip(np.floor((places - self._low) / self._cell), 0, _CELLS_ACROSS), np.int64)

    @staticmethod
    def _number(cell: NDArray[np.int64]) -> NDArray[np.int64]:
        across = _CELLS_ACROSS + 1
        return (cell[..., 0] * across + cell[..., 1]) * across + cell[..., 2]

    def __call__(self, places: Floats) -> NDArray[np.int64]:
        """Numbers (N) of the vertices nearest to places (N×3)."""
        numbers = np.empty(len(places), np.int64)
        for some in self.regions(places):
            numbers[some] = self.about(places[some])(places[some])
        return numbers

    def regions(self, places: Floats) -> list[NDArray[np.int64]]:
        """Numbers of the places (N×3), those that lie together in one array: few vertices are needed for each."""
        every = np.arange(len(places))
        if self._whole is not None or not len(places):
            return [every]
        cells = np.floor(places * (_PARTS_ACROSS / max(float(np.ptp(places, axis=0).max()), 1e-300)))
        order = np.lexsort(cells.T)
        return np.split(order, np.flatnonzero((np.diff(cells[order], axis=0) != 0).any(1)) + 1)

    def about(self, region: Floats) -> Callable[[Floats], NDArray[np.int64]]:
        """A function from places (N×3) that lie in the box about `region` (M×3) to the numbers (N) of the vertices nearest to them."""
        low, high = region.min(0), region.max(0)
        margin = math.inf if self._whole else 0.25 * float((high - low).max())
        tree, rows = self._whole or self._within(low - margin, high + margin)

        def nearest(places: Floats) -> NDArray[np.int64]:
            nonlocal margin, tree, rows
            away, found = tree.query(places, workers=1)
            while (farthest := float(away.max())) > margin:
                # A vertex that is out of the margin may be nearer.
                margin = 2 * margin + 1e-9 if math.isinf(farthest) else farthest
                tree, rows = self._within(low - margin, high + margin)
                away, found = tree.query(places, workers=1)
            return np.asarray(rows[found])

        return nearest

    def _among(self, rows: NDArray[np.int64]) -> tuple[Any, NDArray[np.int64]]:
        return scipy("spatial").cKDTree(self._mesh.vertices[rows]), rows

    def _within(self, low: Floats, high: Floats) -> tuple[Any, NDArray[np.int64]]:
        """A search tree of all vertices in a box, and some beside it."""
        ends = zip(self._cell_of(low).tolist(), self._cell_of(high).tolist(), strict=True)
        cells = np.array(list(itertools.product(*(range(first, last + 1) for first, last in ends))))
        known = [self._rows[number] for number in self._number(cells).tolist() if number in self._rows]
        return self._among(np.concatenate([np.empty(0, np.int64), *(self._sorted[rows] for rows in known)]))


def _levels(full: ObjectMesh, places: Floats) -> NDArray[np.integer]:
    """How often the full mesh's cells were halved at each place (N×3)."""
    if full.level is None or not len(places):
        return np.zeros(len(places), np.uint8)
    return full.level[NearestVertices(full)(places)]


def _atlas(
    points: Floats, triangles: NDArray[Any], levels: NDArray[np.integer], coarseness: int
) -> tuple[int, NDArray[np.int64], NDArray[np.int64], Floats]:
    """Side of the texture in texels, the point of each vertex of the atlas, its triangles, and texture coordinates. points: N×3, in GSD.

    levels: of each triangle; one level more halves its texels' side, if the texture does not become too large.
    """
    xatlas = extra("xatlas", "xatlas", "the texture of an object", "object")
    areas = np.linalg.norm(face_normals(points, triangles), axis=1)
    while (wanted := math.sqrt((areas * 4.0**levels).sum() / 2 / 0.6) * _TEXELS_PER_GSD) > _MOST_SIDE and levels.any():
        levels = np.maximum(levels.astype(np.int64) - 1, 0)
    side = int(np.clip(wanted, 64, _MOST_SIDE)) // coarseness
    atlas = xatlas.Atlas()
    parts = []
    for level in np.unique(levels).tolist():
        # Each level is a part of its own, enlarged, because all charts get the same number of texels per area.
        own = triangles[levels == level]
        used = np.arange(len(points)) if len(own) == len(triangles) else np.unique(own)
        atlas.add_mesh((2**level * points[used]).astype(np.float32), np.searchsorted(used, own).astype(np.uint32))
        parts.append(used)
    packing = xatlas.PackOptions()
    packing.resolution, packing.padding = side, _MARGIN_PX
    atlas.generate(pack_options=packing)
    original, corners, places, count = [], [], [], 0
    for number, used in enumerate(parts):
        of, indices, uv = atlas[number]
        original.append(used[of])
        corners.append(indices.astype(np.int64) + count)
        # xatlas packs into a rectangle and gives shares of its sides; a square texture holds it.
        places.append(uv.astype(np.float64) * (atlas.width, atlas.height))
        count += len(of)
    side = max(atlas.width, atlas.height)
    return side, np.concatenate(original), np.concatenate(corners), np.concatenate(places) / side


def _texels(
    corners_px: Floats, triangles: NDArray[np.int64], side: int, finer: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], Floats]:
    """Row, column, triangle and barycentric shares (N×3) of every sample whose center is inside a triangle; a texel has finer × finer samples."""
    corners = corners_px[triangles] * finer - 0.5
    last = side * finer - 1
    # Rows of samples that cross a triangle, then the samples of each row between the edges that it meets.
    owner, y = _spans(corners[..., 1].min(1), corners[..., 1].max(1), last)
    left, right = np.full(len(owner), np.inf), np.full(len(owner), -np.inf)
    for k in range(3):
        (x0, y0), (x1, y1) = corners[owner, k].T, corners[owner, (k + 1) % 3].T
        met = np.flatnonzero((np.minimum(y0, y1) - _ON_EDGE <= y) & (y <= np.maximum(y0, y1) + _ON_EDGE) & (y0 != y1))
        x0, x1, y0, y1 = x0[met], x1[met], y0[met], y1[met]
        x = x0 + (x1 - x0) * np.clip((y[met] - y0) / (y1 - y0), 0, 1)
        left[met], right[met] = np.minimum(left[met], x), np.maximum(right[met], x)
    some = np.flatnonzero(left <= right)
    row, x = _spans(left[some], right[some], last)
    owner, y = owner[some][row], y[some][row]
    a, b, c = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0]
    inside = np.flatnonzero(area[owner] != 0)
    owner, x, y = owner[inside], x[inside], y[inside]
    across, down = x - a[owner, 0], y - a[owner, 1]
    s, t = ((across * q[owner, 1] - down * q[owner, 0]) / (sign * area[owner]) for q, sign in ((c, 1.0), (b, -1.0)))
    return y // finer, x // finer, owner, np.stack([1 - s - t, s, t], 1)


def _spans(first: Floats, last: Floats, most: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """All whole numbers from 0 to `most` in each of the intervals [first, last] (N each): the interval and the number of each."""
    begin = np.maximum(np.ceil(first - _ON_EDGE), 0).astype(np.int64)
    end = np.minimum(np.floor(last + _ON_EDGE), most).astype(np.int64) + 1
    count = np.maximum(end - begin, 0)
    which = np.repeat(np.arange(len(count)), count)
    return which, np.arange(len(which)) + np.repeat(begin - (np.cumsum(count) - count), count)


def _tangents(points: Floats, normals: Floats, uv: Floats, triangles: NDArray[np.int64]) -> Floats:
    """Directions of growing u, orthogonal to the normals (N×4; the fourth value is the sign of the bitangent for v up)."""
    p, t = points[triangles], uv[triangles] * (1, -1)
    e1, e2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    (u1, v1), (u2, v2) = (t[:, 1] - t[:, 0]).T, (t[:, 2] - t[:, 0]).T
    turn = np.sign(u1 * v2 - u2 * v1)
    along = (e1 * v2[:, None] - e2 * v1[:, None]) * turn[:, None]
    sums = sums_at_vertices(triangles, along, len(points))
    # Where the texture has no area, u has no direction: take any axis, since glTF requires unit tangents everywhere.
    length = np.linalg.norm(sums - normals * (sums * normals).sum(1, keepdims=True), axis=1)
    nowhere = length < 1e-12 * max(float(length.max(initial=0)), 1e-300)
    sums[nowhere] = np.eye(3)[np.abs(normals[nowhere]).argmin(1)]
    sums -= normals * (sums * normals).sum(1, keepdims=True)
    side = sums_at_vertices(triangles, turn, len(points))
    return np.concatenate([unit(sums), np.where(side < 0, -1.0, 1.0)[:, None]], 1)


def _tangent_space(fine: Floats, normals: Floats, along: Floats, sign: Floats) -> Floats:
    """Unit normals in the frame of the coarse surface, tangent first (glTF)."""
    n = unit(normals)
    t = unit(along - n * (along * n).sum(1, keepdims=True))
    b = np.cross(n, t) * sign[:, None]
    local = np.stack([(fine * axis).sum(1) for axis in (t, b, n)], 1)
    local[:, 2] = np.maximum(local[:, 2], 0.05)
    return unit(local)


def _grow(covered: NDArray[np.bool_], images: Sequence[NDArray[np.uint8]]) -> None:
    for _ in range(_MARGIN_PX):
        for axis, shift in ((0, 1), (0, -1), (1, 1), (1, -1)):
            from_there = np.roll(covered, shift, axis) & ~covered
            for image in images:
                image[from_there] = np.roll(image, shift, axis)[from_there]
            covered |= from_there
