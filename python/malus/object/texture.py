"""The mesh for viewers: fewer triangles, a texture atlas (xatlas), color and full-resolution normals baked into it, as GLB."""

from __future__ import annotations

import io
import json
import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from malus._extra import extra
from malus._files import write_bytes
from malus.object.color import blended, display
from malus.object.meshing import ObjectMesh, vertex_normals
from malus.object.views import Floats, View
from malus.units import METRES

#: Texels to a GSD, and the longest side of the texture.
_TEXELS_PER_GSD = 1.5
_MOST_SIDE = 8192
#: Empty texels about a chart that take its border's values, so that filtering finds no seam.
_MARGIN_PX = 4
_QUALITY = 92
_FLOAT, _UINT = 5126, 5125


@dataclass(frozen=True)
class TexturedMesh:
    """vertices, normals: N×3, world, station unit. tangents: N×4 (glTF). uv: N×2, from the top left. triangles: M×3.

    color, normal_map: H×W×3, 8 bit; the second in the tangent frame, OpenGL convention. source: N, the nearest vertex of the full mesh.
    """

    vertices: Floats
    normals: Floats
    tangents: Floats
    uv: Floats
    triangles: NDArray[np.int64]
    color: NDArray[np.uint8]
    normal_map: NDArray[np.uint8]
    source: NDArray[np.int64]


def require_packages() -> None:
    """Raise ExternalError if a package that objects need is missing."""
    for module, package in (("scipy", "scipy"), ("xatlas", "xatlas"), ("fast_simplification", "fast-simplification")):
        extra(module, package, "the surface of an object", "object")


def textured(mesh: ObjectMesh, faces: int, views: Sequence[View], gsd: float) -> TexturedMesh:
    """The mesh with about `faces` triangles at most, and what the stations see of it baked into its texture."""
    spatial = extra("scipy.spatial", "scipy", "the texture of an object", "object")
    middle = mesh.vertices.mean(0)
    points, triangles = mesh.vertices - middle, mesh.triangles
    if len(triangles) > faces:
        library = extra("fast_simplification", "fast-simplification", "the texture of an object", "object")
        points, triangles = library.simplify(points.astype(np.float32), triangles.astype(np.int32), target_count=faces)
        points = points.astype(np.float64)
    side, original, triangles, uv = _atlas(points, triangles, gsd)
    normals = vertex_normals(points, _welded(triangles, original))[original]
    points = points[original] + middle
    tree = spatial.cKDTree(mesh.vertices)
    rows, columns, owner, shares = _texels(uv * side, triangles, side)
    places = (shares[..., None] * points[triangles[owner]]).sum(1)
    nearest = tree.query(places, workers=1)[1]
    tangents = _tangents(points, normals, uv, triangles)
    frame = (shares[..., None] * normals[triangles[owner]]).sum(1)
    along = (shares[..., None] * tangents[triangles[owner], :3]).sum(1)
    sign = tangents[triangles[owner, None], 3][:, 0, 0] if len(owner) else np.ones(0)
    color = np.zeros((side, side, 3), np.uint8)
    fine = np.zeros((side, side, 3), np.uint8)
    color[rows, columns] = display(blended(mesh.vertices[nearest], mesh.normals[nearest], views))
    fine[rows, columns] = _tangent_space(mesh.normals[nearest], frame, along, sign)
    covered = np.zeros((side, side), bool)
    covered[rows, columns] = True
    _grow(covered, (color, fine))
    return TexturedMesh(points, normals, tangents, uv, triangles, color, fine, tree.query(points, workers=1)[1])


def _atlas(
    points: Floats, triangles: NDArray[Any], gsd: float
) -> tuple[int, NDArray[np.int64], NDArray[np.int64], Floats]:
    """Side of the texture in texels, the point of each vertex of the atlas, its triangles, and texture coordinates."""
    xatlas = extra("xatlas", "xatlas", "the texture of an object", "object")
    corners = points[triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    side = int(np.clip(math.sqrt(area / 0.6) * _TEXELS_PER_GSD / gsd, 64, _MOST_SIDE))
    atlas = xatlas.Atlas()
    atlas.add_mesh(points.astype(np.float32), triangles.astype(np.uint32))
    packing = xatlas.PackOptions()
    packing.resolution, packing.padding = side, _MARGIN_PX
    atlas.generate(pack_options=packing)
    original, indices, uv = atlas[0]
    # xatlas packs into a rectangle and gives shares of its sides; a square texture holds it.
    uv = uv.astype(np.float64) * (atlas.width, atlas.height)
    side = max(atlas.width, atlas.height)
    return side, original.astype(np.int64), indices.astype(np.int64), uv / side


def _welded(triangles: NDArray[np.int64], original: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.asarray(original[triangles])


def _texels(
    corners_px: Floats, triangles: NDArray[np.int64], side: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], Floats]:
    """Row, column, triangle and barycentric shares (N×3) of every texel whose center a triangle holds."""
    a, b, c = (corners_px[triangles[:, k]] - 0.5 for k in range(3))
    low = np.floor(np.minimum(np.minimum(a, b), c)).astype(np.int64)
    size = np.ceil(np.maximum(np.maximum(a, b), c)).astype(np.int64) - low + 1
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    parts: list[tuple[Any, ...]] = []
    # Triangles are small: all of them at once for each place in their boxes.
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
            held = (s >= -1e-9) & (t >= -1e-9) & (s + t <= 1 + 1e-9) & (p >= 0).all(1) & (p < side).all(1)
            s, t = s[held], t[held]
            parts.append((p[held, 1], p[held, 0], some[held], np.stack([s, t, 1 - s - t], 1)))
    rows, columns, owner, shares = (np.concatenate(values) for values in zip(*parts, strict=True))
    return rows, columns, owner, shares


def _tangents(points: Floats, normals: Floats, uv: Floats, triangles: NDArray[np.int64]) -> Floats:
    """Directions of growing u (N×4; the last is the side that v up lies on), orthogonal to the normals."""
    p, t = points[triangles], uv[triangles] * (1, -1)
    e1, e2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    (u1, v1), (u2, v2) = (t[:, 1] - t[:, 0]).T, (t[:, 2] - t[:, 0]).T
    turn = np.sign(u1 * v2 - u2 * v1)
    along = (e1 * v2[:, None] - e2 * v1[:, None]) * turn[:, None]
    sums = np.stack([np.bincount(triangles.ravel(), np.repeat(along[:, k], 3), len(points)) for k in range(3)], 1)
    # Where the texture has no area, u grows nowhere: along any axis, as glTF wants unit vectors everywhere.
    length = np.linalg.norm(sums - normals * (sums * normals).sum(1, keepdims=True), axis=1)
    nowhere = length < 1e-12 * max(float(length.max(initial=0)), 1e-300)
    sums[nowhere] = np.eye(3)[np.abs(normals[nowhere]).argmin(1)]
    sums -= normals * (sums * normals).sum(1, keepdims=True)
    side = np.bincount(triangles.ravel(), np.repeat(turn, 3), len(points))
    unit = sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-30)
    return np.concatenate([unit, np.where(side < 0, -1.0, 1.0)[:, None]], 1)


def _tangent_space(fine: Floats, normals: Floats, along: Floats, sign: Floats) -> NDArray[np.uint8]:
    n = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    t = along - n * (along * n).sum(1, keepdims=True)
    t /= np.maximum(np.linalg.norm(t, axis=1, keepdims=True), 1e-30)
    b = np.cross(n, t) * sign[:, None]
    local = np.stack([(fine * axis).sum(1) for axis in (t, b, n)], 1)
    local[:, 2] = np.maximum(local[:, 2], 0.05)
    local /= np.linalg.norm(local, axis=1, keepdims=True)
    return np.rint((local + 1) * 127.5).astype(np.uint8)


def _grow(covered: NDArray[np.bool_], images: Sequence[NDArray[np.uint8]]) -> None:
    for _ in range(_MARGIN_PX):
        for axis, shift in ((0, 1), (0, -1), (1, 1), (1, -1)):
            from_there = np.roll(covered, shift, axis) & ~covered
            for image in images:
                image[from_there] = np.roll(image, shift, axis)[from_there]
            covered |= from_there


def encoded(image: NDArray[np.uint8], kind: str) -> bytes:
    """An image file in memory: JPEG, PNG or WEBP."""
    content = io.BytesIO()
    Image.fromarray(image).save(content, kind, quality=_QUALITY)
    return content.getvalue()


def write_glb(path: Path, mesh: TexturedMesh, unit: str, name: str) -> None:
    """Write a textured mesh as binary glTF 2.0: meters, with its origin at the middle of the object."""
    middle = (mesh.vertices.min(0) + mesh.vertices.max(0)) / 2
    points = ((mesh.vertices - middle) * METRES[unit]).astype("<f4")
    arrays: list[tuple[str, NDArray[Any], int]] = [
        ("VEC3", points, _FLOAT),
        ("VEC3", mesh.normals.astype("<f4"), _FLOAT),
        ("VEC4", mesh.tangents.astype("<f4"), _FLOAT),
        ("VEC2", mesh.uv.astype("<f4"), _FLOAT),
        ("SCALAR", mesh.triangles.astype("<u4").ravel(), _UINT),
    ]
    blocks = [array.tobytes() for _, array, _ in arrays]
    blocks += [encoded(mesh.color, "JPEG"), encoded(mesh.normal_map, "PNG")]
    padded = [block + bytes(-len(block) % 4) for block in blocks]
    starts = np.cumsum([0, *map(len, padded)]).tolist()
    accessors: list[dict[str, Any]] = [
        {"bufferView": k, "componentType": kind, "count": len(array), "type": shape}
        for k, (shape, array, kind) in enumerate(arrays)
    ]
    accessors[0] |= {"min": points.min(0).tolist(), "max": points.max(0).tolist()}
    attributes = {"POSITION": 0, "NORMAL": 1, "TANGENT": 2, "TEXCOORD_0": 3}
    document = {
        "asset": {"version": "2.0", "generator": "Malus"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": name, "extras": {"origin": middle.tolist(), "unit": unit}}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 4, "material": 0}]}],
        "materials": [
            {
                "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0, "roughnessFactor": 0.9},
                "normalTexture": {"index": 1},
            }
        ],
        "textures": [{"source": 0}, {"source": 1}],
        "images": [{"bufferView": 5, "mimeType": "image/jpeg"}, {"bufferView": 6, "mimeType": "image/png"}],
        "accessors": accessors,
        "bufferViews": [
            {"buffer": 0, "byteOffset": start, "byteLength": len(block)}
            for start, block in zip(starts, blocks, strict=False)
        ],
        "buffers": [{"byteLength": starts[-1]}],
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body = b"".join(padded)
    head = struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + len(body))
    write_bytes(
        path, head + struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(body), b"BIN\0") + body
    )
