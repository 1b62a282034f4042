"""Reading point clouds in LAS and E57, as a prior or a reference, for the C++ library (extra `export`: laspy, pye57)."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from malus._e57_xml import require_fields_of_points
from malus._extra import extra
from malus._files import open_regular
from malus._laz import fields_of
from malus.errors import ExternalError, InputError
from malus.units import METERS

#: Points, N×3, and normals, N×3 or None.
Cloud: TypeAlias = tuple[NDArray[np.float64], NDArray[np.float32] | None]

#: Formats that only the Python package reads (io/point_cloud_file.cpp tells this to users of malus-station).
SUFFIXES = frozenset((".las", ".laz", ".e57"))
_NORMALS = {".las": ("normal_x", "normal_y", "normal_z"), ".e57": ("nor:normalX", "nor:normalY", "nor:normalZ")}
#: E57: the coordinates that a scan may have, and the field that says which of its points are valid.
_E57_PLACES = (
    ("cartesianX", "cartesianY", "cartesianZ", "cartesianInvalidState"),
    ("sphericalRange", "sphericalAzimuth", "sphericalElevation", "sphericalInvalidState"),
)
#: Points of a LAS file that are read at a time.
_AT_ONCE = 1_000_000
#: Least share of its length that a point takes in a LAZ file. A flat grid without color takes 4e-4.
_LEAST_COMPRESSED = 1e-4


def is_scan(path: Path) -> bool:
    """Whether the file's suffix is that of a cloud in LAS or E57."""
    return path.suffix.lower() in SUFFIXES


def read_scan(path: Path, unit: str) -> Cloud:
    """Points (N×3, in `unit`) and their unit normals (N×3, 0 where one is unknown) if the file has normals.

    LAS states no unit: its coordinates are taken to be in `unit`. E57 is in meters by its standard. All scans of an E57 file
    are read, transformed into the file's common frame. Raises InputError for a file that cannot be read, holds fewer points than
    its header counts, or has no points or some that are not finite; ExternalError without the package.
    """
    is_e57 = path.suffix.lower() == ".e57"
    name, kind = ("pye57", "E57") if is_e57 else ("laspy", "LAS")
    library = extra(name, name, f"{path}: {kind}")
    try:
        open_regular(path).close()  # the libraries would wait for a pipe
        points, normals = _read_e57(library, path, unit) if is_e57 else _read_las(library, path)
    except (MemoryError, ExternalError):
        raise
    except Exception as error:  # for a damaged file both libraries may raise any exception
        said = str(error).partition("\n")[0] or type(error).__name__
        raise InputError(f"{path}: is not a cloud that can be read ({said})") from None
    if not len(points):
        raise InputError(f"{path}: has no points")
    if bad := len(points) - int(np.isfinite(points).all(1).sum()):
        raise InputError(f"{path}: {bad} of {len(points)} points have coordinates that are not finite")
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


def _read_las(library: Any, path: Path) -> Cloud:
    _require_possible_records(path)
    # Extended records may state any length, and none has points.
    with library.open(str(path), read_evlrs=False) as reader:
        header = reader.header
        has_normals = set(_NORMALS[".las"]) <= set(header.point_format.dimension_names)
        names = [*"xyz", *(_NORMALS[".las"] if has_normals else ())]
        if header.are_points_compressed:
            _require_same_length(header)
            table = fields_of(path, names)
        else:
            parts = [
                np.stack([np.asarray(some[name]) for name in names], axis=1) for some in reader.chunk_iterator(_AT_ONCE)
            ]
            table = np.concatenate([np.empty((0, len(names))), *parts])
    _require_all(len(table), header.point_count)
    normals = table[:, 3:].astype(np.float32) if has_normals else None
    return np.array(table[:, :3]), normals


def _require_all(found: int, counted: int) -> None:
    if found != counted:
        raise ValueError(f"its header counts {counted} points, but the file holds {found}")


def _require_same_length(header: Any) -> None:
    """ValueError if the decoder's record of a LAZ file states points of another length: it would allocate memory for these."""
    record = header.vlrs.get("LasZipVlr")[0]
    length = extra("lazrs", "lazrs", "LAZ").LazVlr(record.record_data).item_size()
    if length != header.point_format.size:
        raise ValueError(f"its points have {header.point_format.size} bytes by one header and {length} by another")


def _require_possible_records(path: Path) -> None:
    """ValueError for a LAS header that counts more records than the file has room for; laspy would try to read them all."""
    with path.open("rb") as file:
        header = file.read(375)
    if len(header) < 111:
        return
    record = 54  # least length of a variable length record
    count = int.from_bytes(header[100:104], "little")
    if count * record > path.stat().st_size:
        raise ValueError(f"its header counts {count} records, more than the file has room for")
    points = int.from_bytes(header[107:111], "little")
    if header[25] >= 4:  # also if the file ends within the count: laspy takes what there is of it
        points = max(points, int.from_bytes(header[247:255], "little"))
    length = max(int.from_bytes(header[105:107], "little"), 1)
    least = _LEAST_COMPRESSED * length if header[104] & 0x80 else length
    if points * least > path.stat().st_size:
        raise ValueError(f"its header counts {points} points, more than the file has room for")


def _read_e57(library: Any, path: Path, unit: str) -> Cloud:
    require_fields_of_points(path)
    size = path.stat().st_size
    file = library.E57(str(path))
    try:
        scans = [_e57_scan(library.libe57, file, file.get_header(k), size) for k in range(file.scan_count)]
    finally:
        file.close()
    cloud = np.concatenate([np.empty((0, 3)), *(points for points, _ in scans)])
    normals = [directions for _, directions in scans if directions is not None]
    return (
        np.ascontiguousarray(cloud / METERS[unit], dtype=np.float64),
        np.concatenate(normals) if normals and len(normals) == len(scans) else None,
    )


def _e57_scan(library: Any, file: Any, header: Any, size: int) -> Cloud:
    """Points [m] and normals, if it has them, of the valid points of a scan of a file of this size, in the file's common frame.

    pye57's own reader knows no fields of extensions, and takes what was in memory before for points that the file does not hold.
    """
    fields = set(header.point_fields)
    *places, state = next((names for names in _E57_PLACES if set(names[:3]) <= fields), ("", "", "", ""))
    if not state:
        raise ValueError("a scan has no coordinates")
    count = int(header.point_count)
    if count > 8 * size:  # a point takes a bit at least
        raise ValueError(f"its header counts {count} points, more than the file has room for")
    directions = [name for name in _NORMALS[".e57"] if set(_NORMALS[".e57"]) <= fields]
    values = {name: np.empty(count) for name in [*places, *directions, *({state} & fields)]}
    buffers = library.VectorSourceDestBuffer()
    for name, array in values.items():
        buffers.append(library.SourceDestBuffer(file.image_file, name, array, count, True, True))
    _require_all(header.points.reader(buffers).read() if count else 0, count)
    valid = values[state] == 0 if state in values else np.full(count, True)
    points = np.stack([values[name][valid] for name in places], axis=1)
    if state == "sphericalInvalidState":
        distance, azimuth, elevation = points.T
        level = distance * np.cos(elevation)
        points = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), distance * np.sin(elevation)], axis=1)
    rotation, translation = np.eye(3), np.zeros(3)
    if header.has_pose():
        rotation, translation = header.rotation_matrix, header.translation
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6):
        raise ValueError("the pose of a scan has no rotation")
    normals = np.stack([values[name][valid] for name in directions], axis=1) @ rotation.T if directions else None
    return points @ rotation.T + translation, None if normals is None else normals.astype(np.float32)
