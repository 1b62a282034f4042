"""The mesh for viewers: fewer triangles, and a texture atlas (xatlas) with baked color and full-resolution normals."""

from __future__ import annotations

import math
from collections.abc import Sequence
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
#: Most levels of detail, and fewest triangles of a level.
_MOST_LEVELS = 5
_LEAST_FACES = 500
#: Most vertices of a mesh that is searched with one tree in memory; where it is searched for its levels, it has so many parts across.
_MOST_IN_MEMORY, _PARTS_ACROSS = 4_000_000, 16


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
    # In GSD: both libraries have limits of length and area of their own, which a mesh in meters is below.
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
    # Neighboring triangles come together, so that few vertices of the full mesh are needed at a time.
    order = np.lexsort(
        np.floor(flat.vertices[flat.triangles[:, 0]] / (64 * np.ptp(flat.vertices, axis=0).max() / side)).T
    )
    for some in _in_portions(flat, order, coarseness):
        triangles = flat.triangles[some]
        rows, columns, owner, shares = _texels(flat.uv * side, triangles, side, coarseness)
        places = (shares[..., None] * flat.vertices[triangles[owner]]).sum(1)
        nearest = find(places)
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


def _in_portions(flat: TexturedMesh, order: NDArray[np.int64], finer: int) -> list[NDArray[np.int64]]:
    """The triangles in this order, in portions of about CHUNK samples."""
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
        # Vertices follow each other block by block, so that most chunks lie elsewhere as a whole.
        self._chunks = chunks(len(mesh.vertices)) if self._whole is None else []
        self._boxes = [(mesh.vertices[rows].min(0), mesh.vertices[rows].max(0)) for rows in self._chunks]

    def _among(self, rows: NDArray[np.int64]) -> tuple[Any, NDArray[np.int64]]:
        return scipy("spatial").cKDTree(self._mesh.vertices[rows]), rows

    def __call__(self, places: Floats) -> NDArray[np.int64]:
        """Numbers (N) of the nearest vertices."""
        tree, rows = self._whole or self._among(self._about(places))
        return np.asarray(rows[tree.query(places, workers=1)[1]])

    def _about(self, places: Floats) -> NDArray[np.int64]:
        low, high = places.min(0), places.max(0)
        margin = 0.25 * (high - low).max()
        while True:
            parts = [np.empty(0, np.int64)]
            for rows, (least, most) in zip(self._chunks, self._boxes, strict=True):
                if (most >= low - margin).all() and (least <= high + margin).all():
                    vertices = self._mesh.vertices[rows]
                    near = ((vertices >= low - margin) & (vertices <= high + margin)).all(1)
                    parts.append(rows.start + np.flatnonzero(near))
            if len(found := np.concatenate(parts)):
                return found
            margin = 2 * margin + 1e-9


def _levels(full: ObjectMesh, places: Floats) -> NDArray[np.integer]:
    """How often the full mesh's cells were halved at each place (N×3)."""
    levels = np.zeros(len(places), np.uint8)
    if full.level is None or not len(places):
        return levels
    find = NearestVertices(full)
    # Neighboring places come together, so that few vertices of the full mesh are needed at a time.
    cells = np.floor(places * (_PARTS_ACROSS / max(float(np.ptp(places, axis=0).max()), 1e-300)))
    order = np.lexsort(cells.T)
    ends = np.flatnonzero((np.diff(cells[order], axis=0) != 0).any(1)) + 1
    for some in np.split(order, ends):
        levels[some] = full.level[find(places[some])]
    return levels


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
        # A part of its own, enlarged: all charts get as many texels for their size.
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
    a, b, c = (corners_px[triangles[:, k]] * finer - 0.5 for k in range(3))
    low = np.floor(np.minimum(np.minimum(a, b), c)).astype(np.int64)
    size = np.ceil(np.maximum(np.maximum(a, b), c)).astype(np.int64) - low + 1
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    parts: list[tuple[Any, ...]] = []
    # Triangles are small: loop over the offsets in their bounding boxes, all triangles at once.
    for dy in range(int(size[:, 1].max())):
        some = np.flatnonzero((size[:, 1] > dy) & (area != 0))
        for dx in range(int(size[some, 0].max()) if len(some) else 0):
            some = some[size[some, 0] > dx]
            p = low[some] + (dx, dy)
            s, t = (
                ((q[some, 0] - p[:, 0]) * (r[some, 1] - p[:, 1]) - (q[some, 1] - p[:, 1]) * (r[some, 0] - p[:, 0]))
                / area[some]
                for q, r in ((b, c), (c, a))
            )
            held = (s >= -1e-9) & (t >= -1e-9) & (s + t <= 1 + 1e-9) & (p >= 0).all(1) & (p < side * finer).all(1)
            s, t = s[held], t[held]
            parts.append((p[held, 1] // finer, p[held, 0] // finer, some[held], np.stack([s, t, 1 - s - t], 1)))
    rows, columns, owner, shares = (np.concatenate(values) for values in zip(*parts, strict=True))
    return rows, columns, owner, shares


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
