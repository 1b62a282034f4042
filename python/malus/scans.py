"""Reading point clouds in LAS and E57, as a prior or a reference, for the C++ library (extra `export`: laspy, pye57)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus._extra import extra
from malus.errors import ExternalError, InputError
from malus.units import METERS

#: Formats that only the Python package reads (io/point_cloud_file.cpp tells this to users of malus-station).
SUFFIXES = frozenset((".las", ".laz", ".e57"))
_NORMALS = {".las": ("normal_x", "normal_y", "normal_z"), ".e57": ("nor:normalX", "nor:normalY", "nor:normalZ")}


def is_scan(path: Path) -> bool:
    """Whether the file's suffix is that of a cloud in LAS or E57."""
    return path.suffix.lower() in SUFFIXES


def read_scan(path: Path, unit: str) -> tuple[NDArray[np.float64], NDArray[np.float32] | None]:
    """Points (N×3, in `unit`) and their unit normals (N×3, 0 where one is unknown) if the file has normals.

    LAS states no unit: its coordinates are taken to be in `unit`. E57 is in meters by its standard. All scans of an E57 file
    are read, transformed into the file's common frame. Raises InputError for a file that cannot be read or has no points,
    ExternalError without the package that reads it.
    """
    try:
        points, normals = _read_e57(path, unit) if path.suffix.lower() == ".e57" else _read_las(path)
    except ExternalError:  # a package is missing
        raise
    except (OSError, ValueError, RuntimeError, KeyError) as error:
        raise InputError(f"{path}: is not a cloud that can be read ({error})") from None
    if not len(points):
        raise InputError(f"{path}: has no points")
    return points, None if normals is None else _units(normals)


def _units(normals: NDArray[np.float32]) -> NDArray[np.float32]:
    """Normals of length 1; (0, 0, 0), which stands for an unknown normal, where there is none or a value is not finite."""
    known = np.where(np.isfinite(normals).all(1, keepdims=True), normals, 0)
    lengths = np.linalg.norm(known, axis=1, keepdims=True)
    return np.asarray(known / np.where(lengths > 0, lengths, 1), dtype=np.float32)


def as_ply(points: NDArray[np.float64], normals: NDArray[np.float32] | None, folder: Path) -> Path:
    """FOLDER/scan.ply with a cloud as `read_scan` returns it, which the C++ library can read."""
    from malus.object.ply import columns, write_ply  # malus.object imports this module

    properties = columns("xyz", points, "f8")
    if normals is not None:
        properties |= columns(("nx", "ny", "nz"), normals, "f4")
    folder.mkdir(parents=True, exist_ok=True)
    write_ply(folder / "scan.ply", properties, None, "reference scan")
    return folder / "scan.ply"


def _read_las(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float32] | None]:
    library = extra("laspy", "laspy", f"{path}: LAS")
    _require_possible_records(path)
    try:
        content = library.read(path)
    except (MemoryError, OSError):
        raise
    except Exception as error:  # for a damaged file laspy may raise any exception
        raise ValueError(error) from None
    names = _NORMALS[".las"]
    normals = None
    if set(names) <= set(content.point_format.dimension_names):
        normals = np.stack([np.asarray(content[name], dtype=np.float32) for name in names], axis=1)
    return np.ascontiguousarray(content.xyz, dtype=np.float64), normals


def _require_possible_records(path: Path) -> None:
    """ValueError for a LAS header that counts more records than the file has room for; laspy would try to read them all."""
    with path.open("rb") as file:
        header = file.read(375)
    # Offsets of the counts, and least lengths, of variable length records and, since version 1.4, of extended ones.
    for offset, length in ((100, 54), (243, 60)):
        if len(header) < offset + 4 or (offset == 243 and header[25] < 4):
            continue
        count = int.from_bytes(header[offset : offset + 4], "little")
        if count * length > path.stat().st_size:
            raise ValueError(f"its header counts {count} records, more than the file has room for")
    if len(header) < 111:
        return
    points = int.from_bytes(header[107:111], "little")
    if len(header) >= 255 and header[25] >= 4:
        points = max(points, int.from_bytes(header[247:255], "little"))
    # A compressed point (LAZ) takes a fraction of a byte at least.
    least = 1e-3 if header[104] & 0x80 else max(int.from_bytes(header[105:107], "little"), 1)
    if points * least > path.stat().st_size:
        raise ValueError(f"its header counts {points} points, more than the file has room for")


def _read_e57(path: Path, unit: str) -> tuple[NDArray[np.float64], NDArray[np.float32] | None]:
    library = extra("pye57", "pye57", f"{path}: E57")
    names = _NORMALS[".e57"]
    points, normals = [], []
    try:
        file = library.E57(str(path))
        try:
            for index in range(file.scan_count):
                header = file.get_header(index)
                scan = file.read_scan(index, ignore_missing_fields=True)
                points.append(np.stack([scan[name] for name in ("cartesianX", "cartesianY", "cartesianZ")], axis=1))
                if set(names) <= set(header.point_fields):
                    rotation = header.rotation_matrix if header.has_pose() else np.eye(3)
                    normals.append(_e57_normals(library, file, header) @ rotation.T)
        finally:
            file.close()
    except library.libe57.E57Exception as error:  # also of a damaged page among the points
        raise ValueError(str(error).splitlines()[0]) from None
    cloud = np.concatenate(points) if points else np.empty((0, 3))
    complete = len(normals) == len(points) and sum(map(len, normals)) == len(cloud)
    return (
        np.ascontiguousarray(cloud / METERS[unit], dtype=np.float64),
        np.concatenate(normals).astype(np.float32) if normals and complete else None,
    )


def _e57_normals(library: Any, file: Any, header: Any) -> NDArray[np.float64]:
    """Normals (N×3) of the valid points of a scan, in the scan's frame. pye57 itself reads no fields of extensions."""
    names = [*_NORMALS[".e57"], *({"cartesianInvalidState", "sphericalInvalidState"} & set(header.point_fields))]
    count = header.point_count
    values = {name: np.empty(count) for name in names}
    buffers = library.libe57.VectorSourceDestBuffer()
    for name, array in values.items():
        buffers.append(library.libe57.SourceDestBuffer(file.image_file, name, array, count, True, True))
    header.points.reader(buffers).read()
    valid = np.all([values[name] == 0 for name in names[3:]], axis=0) if names[3:] else np.full(count, True)
    return np.stack([values[name][valid] for name in names[:3]], axis=1)
