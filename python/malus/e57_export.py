"""Points with color and normals as an E57 file (ASTM E2807).

pye57 writes the nodes, but not by its own function for whole scans, which knows no normals and states what was never measured: times
in 1980, and an air pressure of 0, which the standard forbids.
"""

from __future__ import annotations

import uuid
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus._extra import extra
from malus._files import replacing
from malus.xmp import NAMESPACE

_NORMALS_EXTENSION = "http://www.libe57.org/E57_NOR_surface_normals.txt"
_COLORS = ("Red", "Green", "Blue")


def write_e57(
    path: Path,
    points: NDArray[np.float64],
    normals: NDArray[np.floating],
    colors: NDArray[np.uint8],
    middle: NDArray[np.float64],
    name: str,
    said: Mapping[str, str],
) -> None:
    """Write one scan: points (N×3, meters, about `middle`, which its pose adds to them), unit normals (N×3) and colors (N×3, sRGB).

    Coordinates are stored as floats of 32 bits. E57 has no elements for unit, confidence and catalog entries: `said` goes into an
    extension of our own, which the standard allows. Programs show only the scan's name.
    """
    library = extra("pye57", "pye57", f"{path}: E57").libe57
    fields: dict[str, NDArray[Any]] = {}
    for kind, values in (("cartesian", points), ("nor:normal", np.clip(normals, -1, 1))):
        fields |= {f"{kind}{axis}": np.ascontiguousarray(values[:, k], np.float32) for k, axis in enumerate("XYZ")}
    fields |= {f"color{color}": np.ascontiguousarray(colors[:, k]) for k, color in enumerate(_COLORS)}
    with replacing(path) as temporary:
        file = library.ImageFile(str(temporary), "w")
        for prefix, address in (("", library.E57_V1_0_URI), ("nor", _NORMALS_EXTENSION), ("malus", NAMESPACE)):
            file.extensionsAdd(prefix, address)
        nodes = _Nodes(library, file)
        root, scans = file.root(), library.VectorNode(file, True)
        nodes.fill(root, {"formatName": "ASTM E57 3D Imaging Data File", "guid": f"{{{uuid.uuid4()}}}"})
        nodes.fill(root, {"versionMajor": library.E57_FORMAT_MAJOR, "versionMinor": library.E57_FORMAT_MINOR})
        nodes.fill(root, {"e57LibraryVersion": library.E57_LIBRARY_ID})
        root.set("data3D", scans)
        root.set("images2D", library.VectorNode(file, True))
        scan = nodes.structure(_about_scan(fields, middle, name, said))
        stored = library.CompressedVectorNode(file, nodes.prototype(fields), library.VectorNode(file, True))
        scan.set("points", stored)
        scans.append(scan)
        buffers = library.VectorSourceDestBuffer()
        for field, values in fields.items():
            buffers.append(library.SourceDestBuffer(file, field, values, len(values), True, True))
        writer = stored.writer(buffers)
        writer.write(len(points))
        writer.close()
        file.close()


def _about_scan(
    fields: Mapping[str, NDArray[Any]], middle: NDArray[np.float64], name: str, said: Mapping[str, str]
) -> dict[str, Any]:
    """What the file states about its scan; the bounds are in the frame of the stored points."""
    ends = (("Minimum", np.min), ("Maximum", np.max))
    bounds = {f"{axis.lower()}{end}": float(of(fields[f"cartesian{axis}"])) for axis in "XYZ" for end, of in ends}
    levels = {f"color{color}{end}": level for color in _COLORS for end, level in (("Minimum", 0), ("Maximum", 255))}
    rotation = {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0}
    translation = dict(zip("xyz", middle.tolist(), strict=True))
    return {
        "guid": f"{{{uuid.uuid4()}}}",
        "name": name,
        "pose": {"rotation": rotation, "translation": translation},
        "cartesianBounds": bounds,
        "colorLimits": levels,
        **{f"malus:{key}": words for key, words in said.items()},
    }


class _Nodes:
    """Makes the nodes of an E57 file from plain values."""

    def __init__(self, library: Any, file: Any) -> None:
        self._library, self._file = library, file

    def fill(self, structure: Any, values: Mapping[str, Any]) -> None:
        """Add values (text, whole numbers, numbers, structures) to a structure that lies in the file already."""
        kinds = {str: self._library.StringNode, int: self._library.IntegerNode, float: self._library.FloatNode}
        for key, value in values.items():
            is_structure = isinstance(value, Mapping)
            structure.set(key, self.structure(value) if is_structure else kinds[type(value)](self._file, value))

    def structure(self, values: Mapping[str, Any]) -> Any:
        """A new structure of these values."""
        made = self._library.StructureNode(self._file)
        self.fill(made, values)
        return made

    def prototype(self, fields: Mapping[str, NDArray[Any]]) -> Any:
        """The structure that states type and range of each field of a point."""
        made = self._library.StructureNode(self._file)
        for name, values in fields.items():
            if values.dtype == np.uint8:
                made.set(name, self._library.IntegerNode(self._file, 0, 0, 255))
            else:
                low, high = (-1.0, 1.0) if name.startswith("nor:") else (float(values.min()), float(values.max()))
                made.set(name, self._library.FloatNode(self._file, low, self._library.E57_SINGLE, low, high))
        return made
