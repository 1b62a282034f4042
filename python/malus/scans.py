"""Reading point clouds in LAS and E57, as a prior or a reference, for the C++ library (extra `export`: laspy, pye57)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from malus._e57_xml import require_fields_of_points
from malus._extra import extra
from malus._files import open_regular
from malus._laz import decoded, records_of
from malus.errors import ExternalError, InputError
from malus.units import METERS


class Cloud(NamedTuple):
    """A scan. points: N×3; normals: N×3, of length 1 or, where one is not known, 0; colors: N×3, 0 to 255. None = the file has none."""

    points: NDArray[np.float64]
    normals: NDArray[np.float32] | None
    colors: NDArray[np.uint8] | None


#: Formats that only the Python package reads (io/point_cloud_file.cpp tells this to users of malus-station).
SUFFIXES = frozenset((".las", ".laz", ".e57"))
#: Their fields of normals and colors.
_NORMALS = {".las": ("normal_x", "normal_y", "normal_z"), ".e57": ("nor:normalX", "nor:normalY", "nor:normalZ")}
_COLORS = {".las": ("red", "green", "blue"), ".e57": ("colorRed", "colorGreen", "colorBlue")}
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
    """Points, in `unit`, with the normals and colors that the file has.

    LAS states no unit: its coordinates are taken to be in `unit`. E57 is in meters by its standard. All scans of an E57 file
    are read, transformed into the file's common frame. Raises InputError for a file that cannot be read, holds fewer points than
    its header counts, or has no points or some that are not finite; ExternalError without the package.
    """
    is_e57 = path.suffix.lower() == ".e57"
    name, kind = ("pye57", "E57") if is_e57 else ("laspy", "LAS")
    library = extra(name, name, f"{path}: {kind}")
    try:
        open_regular(path).close()  # the libraries would wait for a pipe
        cloud = _read_e57(library, path, unit) if is_e57 else _read_las(library, path)
    except (MemoryError, ExternalError):
        raise
    except Exception as error:  # for a damaged file both libraries may raise any exception
        said = str(error).partition("\n")[0] or type(error).__name__
        raise InputError(f"{path}: is not a cloud that can be read ({said})") from None
    count = len(cloud.points)
    if not count:
        raise InputError(f"{path}: has no points")
    if bad := count - int(np.isfinite(cloud.points).all(1).sum()):
        raise InputError(f"{path}: {bad} of {count} points have coordinates that are not finite")
    return cloud if cloud.normals is None else cloud._replace(normals=_units(cloud.normals))


def _units(normals: NDArray[np.float32]) -> NDArray[np.float32]:
    """Normals of length 1; (0, 0, 0), which stands for an unknown normal, where there is none or a value is not finite."""
    known = np.where(np.isfinite(normals).all(1, keepdims=True), normals, 0)
    lengths = np.linalg.norm(known, axis=1, keepdims=True)
    return np.asarray(known / np.where(lengths > 0, lengths, 1), dtype=np.float32)


def _bytes(colors: NDArray[Any], limits: Sequence[tuple[float, float]] | None = None) -> NDArray[np.uint8]:
    """Colors (N×3) from 0 to 255; 0 where a value is no number. limits: least and largest value of red, green and blue, if stated;
    otherwise values up to 255 are bytes, which many programs write into fields of 16 bits, and others have 16 bits.
    """
    ends = limits or [(0, 65535 if (colors > 255).any() else 255)] * 3
    values = [np.nan_to_num(np.interp(colors[:, k], ends[k], (0, 255))).round().astype(np.uint8) for k in range(3)]
    return np.stack(values, axis=1)


def as_ply(cloud: Cloud, folder: Path) -> Path:
    """FOLDER/scan.ply with a cloud as `read_scan` returns it, which the C++ library can read."""
    from malus.object.ply import columns, write_ply  # malus.object imports this module

    properties = columns("xyz", cloud.points, "f8")
    if cloud.normals is not None:
        properties |= columns(("nx", "ny", "nz"), cloud.normals, "f4")
    if cloud.colors is not None:
        properties |= columns(("red", "green", "blue"), cloud.colors, "u1")
    folder.mkdir(parents=True, exist_ok=True)
    write_ply(folder / "scan.ply", properties, None, "reference scan")
    return folder / "scan.ply"


def _read_las(library: Any, path: Path) -> Cloud:
    _require_possible_records(path)
    # Extended records may state any length, and none has points.
    with library.open(str(path), read_evlrs=False) as reader:
        header = reader.header
        layout = header.point_format
        normals = _of(_NORMALS[".las"], layout.dimension_names)
        colors = _of(_COLORS[".las"], layout.standard_dimension_names)  # others of these names may be of any type
        kind = np.dtype(
            [*((name, "f8") for name in "xyz"), *((name, "f4") for name in normals), *((name, "u2") for name in colors)]
        )
        if header.are_points_compressed:
            _require_same_length(header)
            records = decoded(path, kind)
        else:
            records = np.concatenate(
                [np.empty(0, kind), *(records_of(some, kind) for some in reader.chunk_iterator(_AT_ONCE))]
            )
    _require_all(len(records), header.point_count)
    return Cloud(
        _columns(records, "xyz"),
        _columns(records, normals) if normals else None,
        _bytes(_columns(records, colors)) if colors else None,
    )


def _of(names: tuple[str, ...], fields: Iterable[str]) -> tuple[str, ...]:
    """These names of fields if all of them are among the fields, else none."""
    return names if set(names) <= set(fields) else ()


def _columns(values: Mapping[str, NDArray[Any]] | NDArray[np.void], names: Iterable[str]) -> NDArray[Any]:
    """N×K values of K fields."""
    return np.stack([values[name] for name in names], axis=1)


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
    if not scans:
        return Cloud(np.empty((0, 3)), None, None)
    points, *others = zip(*scans, strict=True)
    normals, colors = (None if any(part is None for part in parts) else np.concatenate(parts) for parts in others)
    return Cloud(np.ascontiguousarray(np.concatenate(points) / METERS[unit], dtype=np.float64), normals, colors)


def _color_limits(header: Any) -> list[tuple[float, float]] | None:
    """Least and largest value of red, green and blue that an E57 scan states, if it does."""
    if "colorLimits" not in header.scan_fields:
        return None
    stated = header["colorLimits"]
    names = [(f"{color}Minimum", f"{color}Maximum") for color in _COLORS[".e57"]]
    if not all(stated.isDefined(name) for ends in names for name in ends):
        return None

    def number(name: str) -> float:
        node = stated[name]
        return float(node.scaledValue() if hasattr(node, "scaledValue") else node.value())

    limits = [(number(least), number(most)) for least, most in names]
    return limits if all(least < most for least, most in limits) else None


def _e57_scan(library: Any, file: Any, header: Any, size: int) -> Cloud:
    """The valid points [m] of a scan of a file of this size, in the file's common frame, with normals and colors if it has them.

    pye57's own reader does not know fields of extensions, and returns leftover content of memory for points that the file does not hold.
    """
    fields = set(header.point_fields)
    *places, state = next((names for names in _E57_PLACES if set(names[:3]) <= fields), ("", "", "", ""))
    if not state:
        raise ValueError("a scan has no coordinates")
    count = int(header.point_count)
    if count > 8 * size:  # a point takes a bit at least
        raise ValueError(f"its header counts {count} points, more than the file has room for")
    directions, colors = _of(_NORMALS[".e57"], fields), _of(_COLORS[".e57"], fields)
    states = {state, "isColorInvalid"} & fields
    values = {name: np.empty(count) for name in (*places, *directions, *states)}
    values |= {name: np.empty(count, np.float32) for name in colors}
    buffers = library.VectorSourceDestBuffer()
    for name, array in values.items():
        buffers.append(library.SourceDestBuffer(file.image_file, name, array, count, True, True))
    _require_all(header.points.reader(buffers).read() if count else 0, count)
    valid = values[state] == 0 if state in values else np.full(count, True)
    points = _columns(values, places)[valid]
    if state == "sphericalInvalidState":
        distance, azimuth, elevation = points.T
        level = distance * np.cos(elevation)
        points = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), distance * np.sin(elevation)], axis=1)
    rotation, translation = np.eye(3), np.zeros(3)
    if header.has_pose():
        rotation, translation = header.rotation_matrix, header.translation
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6):
        raise ValueError("the pose of a scan has no rotation")
    normals = (_columns(values, directions)[valid] @ rotation.T).astype(np.float32) if directions else None
    painted = _bytes(_columns(values, colors)[valid], _color_limits(header)) if colors else None
    if painted is not None and "isColorInvalid" in values:
        painted[values["isColorInvalid"][valid] != 0] = 0  # black, as the unknown colors of other files
    return Cloud(points @ rotation.T + translation, normals, painted)
