"""Formats with triangles."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from malus import _core
from malus._files import replacing
from malus.columns import number
from malus.errors import DataError, InputError
from malus.exports.beside import files_beside
from malus.exports.exporter import Exporter
from malus.lengths import shown
from malus.object import arrays, glb
from malus.surface import Mesh
from malus.trust import extras_of
from malus.xmp import save_png

#: Largest rounding of a coordinate in an STL file: a tenth of a pixel is about what fusion adds to the coarse surface.
_MOST_ROUNDING_GSD = 0.1


def export_ply(exporter: Exporter, path: Path) -> None:
    """Mesh with vertex colors."""
    mesh = exporter.simplified()
    _core.write_ply(
        str(path), mesh.vertices, mesh.normals, mesh.colors, mesh.triangles, exporter.words(), exporter.threads
    )


def export_glb(exporter: Exporter, path: Path) -> None:
    """Mesh with texture, in meters."""
    mesh = exporter.simplified()
    workspace = exporter.workspace
    with replacing(path) as temporary:  # so that a model that is not turned yet never has the final name
        _core.write_glb(
            str(temporary), mesh.vertices, mesh.normals, mesh.triangles, exporter.texture(), workspace.camera, exporter.unit,
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


def export_obj(exporter: Exporter, path: Path) -> None:
    """Mesh with its texture and material beside it."""
    texture, material = files_beside("obj", path)
    _require_own_texture(path, texture)
    mesh = exporter.simplified()
    save_png(texture, exporter.texture(), exporter.xmp())
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


def _require_own_texture(path: Path, texture: Path) -> None:
    """InputError if another OBJ file of the folder, whose name differs in spaces, has the texture of this name."""
    for other in path.parent.glob("*"):  # none if the folder is yet to be made
        if other.suffix.lower() == ".obj" and other.name != path.name and texture in files_beside("obj", other):
            raise InputError(
                f'{path}: its texture {texture.name} would replace that of {other.name}, because "_" stands for a space in names of '
                "textures; expected another name or folder"
            )


def export_stl(exporter: Exporter, path: Path) -> None:
    """Mesh without colors; DataError if its coordinates are too large for the format."""
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
