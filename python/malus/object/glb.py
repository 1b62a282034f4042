"""Textured meshes as binary glTF 2.0."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus._files import write_bytes
from malus.object.texture import TexturedMesh
from malus.pictures import encode
from malus.units import METERS

_QUALITY = 92
_FLOAT, _UINT = 5126, 5125
_WEBP = "EXT_texture_webp"


def encoded(image: NDArray[np.uint8], kind: str, *, lossless: bool = False) -> bytes:
    """An image file in memory: JPEG, PNG or WEBP."""
    return encode(image, kind, quality=_QUALITY, lossless=lossless)


def glb(
    mesh: TexturedMesh, unit: str, name: str, said: Mapping[str, str] | None = None, *, webp: bool = False
) -> bytes:
    """A textured mesh as a GLB file: meters, with its origin at the middle of the object; `said` goes into asset.extras.

    Textures are JPEG and PNG, which every reader of glTF supports; or WebP, which is smaller, for readers of EXT_texture_webp (Blender,
    three.js).
    """
    middle = (mesh.vertices.min(0) + mesh.vertices.max(0)) / 2
    points = ((mesh.vertices - middle) * METERS[unit]).astype("<f4")
    arrays: list[tuple[str, NDArray[Any], int]] = [
        ("VEC3", points, _FLOAT),
        ("VEC3", mesh.normals.astype("<f4"), _FLOAT),
        ("VEC4", mesh.tangents.astype("<f4"), _FLOAT),
        ("VEC2", mesh.uv.astype("<f4"), _FLOAT),
        ("SCALAR", mesh.triangles.astype("<u4").ravel(), _UINT),
    ]
    blocks = [array.tobytes() for _, array, _ in arrays]
    kinds = ("WEBP", "WEBP") if webp else ("JPEG", "PNG")
    blocks += [encoded(mesh.color, kinds[0]), encoded(mesh.normal_map, kinds[1], lossless=True)]
    padded = [block + bytes(-len(block) % 4) for block in blocks]
    starts = np.cumsum([0, *map(len, padded)]).tolist()
    accessors: list[dict[str, Any]] = [
        {"bufferView": k, "componentType": kind, "count": len(array), "type": shape}
        for k, (shape, array, kind) in enumerate(arrays)
    ]
    accessors[0] |= {"min": points.min(0).tolist(), "max": points.max(0).tolist()}
    attributes = {"POSITION": 0, "NORMAL": 1, "TANGENT": 2, "TEXCOORD_0": 3}
    document = {
        "asset": {"version": "2.0", "generator": "Malus", **({"extras": dict(said)} if said else {})},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": name, "extras": {"origin": middle.tolist(), "unit": unit}}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 4, "material": 0}]}],
        "materials": [
            {
                "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0, "roughnessFactor": 0.9},
                "normalTexture": {"index": 1},
                "doubleSided": True,  # an open surface is also seen from behind
            }
        ],
        "textures": [{"extensions": {_WEBP: {"source": k}}} if webp else {"source": k} for k in range(2)],
        "images": [{"bufferView": 5 + k, "mimeType": f"image/{kind.lower()}"} for k, kind in enumerate(kinds)],
        "accessors": accessors,
        "bufferViews": [
            {"buffer": 0, "byteOffset": start, "byteLength": len(block)}
            for start, block in zip(starts, blocks, strict=False)
        ],
        "buffers": [{"byteLength": starts[-1]}],
    }
    if webp:
        document |= {"extensionsUsed": [_WEBP], "extensionsRequired": [_WEBP]}
    return container(document, b"".join(padded))


def container(document: Mapping[str, Any], body: bytes) -> bytes:
    """A GLB file of its JSON part and its binary part, whose length is a multiple of four."""
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + len(body))
    return head + struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(body), b"BIN\0") + body


def write_levels(
    folder: Path,
    levels: list[TexturedMesh],
    unit: str,
    name: str,
    texture_format: str = "webp",
    said: Mapping[str, str] | None = None,
) -> tuple[list[Path], list[dict[str, Any]]]:
    """Write mesh.glb (JPEG and PNG textures), albedo.glb if the albedo is known, and levels/0.glb … (WebP textures, or with
    texture_format "jpeg" JPEG and PNG). All state `said`. Returns the files and the figures of each level.
    """
    paths = [folder / "mesh.glb", *(folder / "levels" / f"{k}.glb" for k in range(len(levels)))]
    webp = texture_format == "webp"
    contents = [glb(levels[0], unit, name, said), *(glb(level, unit, name, said, webp=webp) for level in levels)]
    if levels[0].albedo is not None:
        paths.append(folder / "albedo.glb")
        contents.append(glb(replace(levels[0], color=levels[0].albedo), unit, name, said))
    for path, content in zip(paths, contents, strict=True):
        write_bytes(path, content)
    figures = [
        {"file": f"levels/{k}.glb", "triangles": len(level.triangles), "texture_px": len(level.color),
         "texture_format": texture_format, "deviation": level.deviation, "bytes": len(contents[k + 1])}
        for k, level in enumerate(levels)
    ]  # fmt: skip
    return paths, figures
