"""Clouds in LAS and E57 as a prior and as a reference."""

from __future__ import annotations

import os
import re
import sys
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest

import malus
from conftest import cloud_of, edit, malus_here, malus_station
from e57_pages import as_file, content_of
from malus import _core
from malus._e57_xml import require_fields_of_points
from malus._files import sha256_of
from malus.scans import as_ply, read_scan


@pytest.fixture
def cloud() -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(4)
    normals = random.normal(size=(500, 3))
    return random.uniform(-20, 20, (500, 3)), normals / np.linalg.norm(normals, axis=1)[:, None]


def write_las(path: Path, points: np.ndarray, normals: np.ndarray, colors: np.ndarray | None = None) -> None:
    """colors: as they are in the file, whose fields have 16 bits."""
    import laspy

    header = laspy.LasHeader(point_format=6 if colors is None else 7, version="1.4")
    header.scales = np.full(3, 1e-5)
    for name in ("normal_x", "normal_y", "normal_z"):
        header.add_extra_dim(laspy.ExtraBytesParams(name=name, type=np.float32))
    data = laspy.LasData(header)
    data.x, data.y, data.z = points.T
    data.normal_x, data.normal_y, data.normal_z = normals.T.astype(np.float32)
    if colors is not None:
        data.red, data.green, data.blue = colors.T.astype(np.uint16)
    data.write(str(path))


def write_e57_with_normals(path: Path, points_mm: np.ndarray, normals: np.ndarray, invalid: np.ndarray) -> None:
    """A scan turned by a quarter turn about z, with the normals' extension, as CloudCompare writes it."""
    import pye57
    from pye57 import libe57

    file = pye57.E57(str(path), mode="w")
    image = file.image_file
    image.extensionsAdd("nor", "http://www.libe57.org/E57_NOR_surface_normals.txt")
    scan, prototype, pose, rotation, translation = (libe57.StructureNode(image) for _ in range(5))
    turn = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]])  # from the world's axes to the scan's
    names = [*(f"cartesian{axis}" for axis in "XYZ"), *(f"nor:normal{axis}" for axis in "XYZ")]
    values = np.hstack([points_mm * 1e-3 @ turn.T, normals @ turn.T])
    arrays = {name: np.ascontiguousarray(values[:, k]) for k, name in enumerate(names)}
    for name in names:
        prototype.set(name, libe57.FloatNode(image, 0.0, libe57.E57_DOUBLE, -10.0, 10.0))
    arrays["cartesianInvalidState"] = invalid.astype(np.int8)
    prototype.set("cartesianInvalidState", libe57.IntegerNode(image, 0, 0, 2))
    for name, value in zip("wxyz", (0.5**0.5, 0, 0, 0.5**0.5), strict=True):
        rotation.set(name, libe57.FloatNode(image, value))
    for axis in "xyz":
        translation.set(axis, libe57.FloatNode(image, 0.0))
    pose.set("rotation", rotation)
    pose.set("translation", translation)
    scan.set("pose", pose)
    points = libe57.CompressedVectorNode(image, prototype, libe57.VectorNode(image, True))
    scan.set("points", points)
    file.data3d.append(scan)
    buffers = libe57.VectorSourceDestBuffer()
    for name, array in arrays.items():
        buffers.append(libe57.SourceDestBuffer(image, name, array, len(array), True, True))
    writer = points.writer(buffers)
    writer.write(len(points_mm))
    writer.close()
    file.close()


def write_e57(path: Path, points_mm: np.ndarray, colors: np.ndarray | None = None, **fields: np.ndarray) -> None:
    """colors: 0 to 255, with limits that say so. fields: others that pye57 can write."""
    import pye57

    file = pye57.E57(str(path), mode="w")
    x, y, z = points_mm.T * 1e-3
    turned = np.array([np.cos(0.2), 0, 0, np.sin(0.2)])  # about z
    inverse = np.array([[np.cos(0.4), np.sin(0.4), 0], [-np.sin(0.4), np.cos(0.4), 0], [0, 0, 1]])
    local = (np.stack([x, y, z], axis=1) - np.array([0.5, 0, 0])) @ inverse.T
    columns = {f"cartesian{axis}": local[:, k].copy() for k, axis in enumerate("XYZ")}
    if colors is not None:
        columns |= {f"color{name}": colors[:, k].copy() for k, name in enumerate(("Red", "Green", "Blue"))}
    file.write_scan_raw(
        {**columns, **fields},
        rotation=turned,
        translation=np.array([0.5, 0, 0]),
    )
    file.close()


def test_las_has_points_and_normals(tmp_path: Path, cloud: tuple[np.ndarray, np.ndarray]) -> None:
    pytest.importorskip("laspy")
    write_las(tmp_path / "cloud.las", *cloud)
    points, normals, _ = read_scan(tmp_path / "cloud.las", "mm")
    np.testing.assert_allclose(points, cloud[0], atol=1e-5)
    assert normals is not None
    np.testing.assert_allclose(normals, cloud[1], atol=1e-6)


def test_e57_is_in_meters_and_in_its_common_frame(tmp_path: Path, cloud: tuple[np.ndarray, np.ndarray]) -> None:
    pytest.importorskip("pye57")
    write_e57(tmp_path / "cloud.e57", cloud[0])
    points, normals, _ = read_scan(tmp_path / "cloud.e57", "mm")
    np.testing.assert_allclose(points, cloud[0], atol=1e-4)
    assert normals is None


def test_e57_with_normals_is_read_with_them(tmp_path: Path, cloud: tuple[np.ndarray, np.ndarray]) -> None:
    """Such files were refused: their normals are fields that the library's own reader does not know."""
    pytest.importorskip("pye57")
    invalid = np.arange(len(cloud[0])) % 5 == 2
    write_e57_with_normals(tmp_path / "cloud.e57", *cloud, 2 * invalid)
    points, normals, _ = read_scan(tmp_path / "cloud.e57", "mm")
    assert normals is not None
    np.testing.assert_allclose(points, cloud[0][~invalid], atol=1e-9)
    np.testing.assert_allclose(normals, cloud[1][~invalid], atol=1e-6)


def test_normals_of_a_scan_have_length_1_or_0(tmp_path: Path, cloud: tuple[np.ndarray, np.ndarray]) -> None:
    pytest.importorskip("laspy")
    given = 3 * cloud[1]
    given[0], given[1] = 0, np.nan
    write_las(tmp_path / "cloud.las", cloud[0], given)
    normals = read_scan(tmp_path / "cloud.las", "mm").normals
    assert normals is not None
    np.testing.assert_allclose(normals[2:], cloud[1][2:], atol=1e-6)
    np.testing.assert_array_equal(normals[:2], 0)


@pytest.fixture
def colors() -> np.ndarray:
    return np.random.default_rng(5).integers(0, 256, (500, 3)).astype(np.uint8)


@pytest.mark.parametrize("name", ["cloud.las", "cloud.laz"])
def test_colors_of_las_have_16_bits_or_8_in_fields_of_16(
    tmp_path: Path, cloud: tuple[np.ndarray, np.ndarray], colors: np.ndarray, name: str
) -> None:
    """They were left out."""
    pytest.importorskip("laspy")
    pytest.importorskip("lazrs")
    path = tmp_path / name
    write_las(path, *cloud)
    assert read_scan(path, "mm").colors is None
    for factor in (1, 257):
        write_las(path, *cloud, colors.astype(int) * factor)
        points, normals, found = read_scan(path, "mm")
        assert found is not None and normals is not None and found.dtype == np.uint8
        np.testing.assert_array_equal(found, colors)
        np.testing.assert_allclose(points, cloud[0], atol=1e-5)
        np.testing.assert_allclose(normals, cloud[1], atol=1e-6)
    # All values of 16 bits, rounded as those of a PLY file.
    every = np.arange(65536)
    write_las(path, np.zeros((65536, 3)), np.zeros((65536, 3)), np.stack([every, every[::-1], every], axis=1))
    found = read_scan(path, "mm").colors
    assert found is not None
    np.testing.assert_array_equal(found[:, 0], np.round(every / 257))
    np.testing.assert_array_equal(found[:, 1], np.round(every[::-1] / 257))


def test_fields_of_las_that_are_only_called_like_colors_are_none(tmp_path: Path) -> None:
    laspy = pytest.importorskip("laspy")
    header = laspy.LasHeader(point_format=6, version="1.4")
    for name in ("red", "green", "blue"):
        header.add_extra_dim(laspy.ExtraBytesParams(name=name, type="3f8"))
    las = laspy.LasData(header)
    las.x = las.y = las.z = np.arange(3.0)
    las.write(str(tmp_path / "cloud.las"))
    assert read_scan(tmp_path / "cloud.las", "mm").colors is None


def test_colors_of_e57_lie_between_the_limits_that_it_states(
    tmp_path: Path, cloud: tuple[np.ndarray, np.ndarray], colors: np.ndarray
) -> None:
    """They were left out."""
    pytest.importorskip("pye57")
    path = tmp_path / "cloud.e57"
    write_e57(path, cloud[0])
    assert read_scan(path, "mm").colors is None
    write_e57(path, cloud[0], colors)
    whole = content_of(path.read_bytes())

    def read(limits: bytes, most: bytes) -> np.ndarray:
        """With another element for the limits, or another upper limit of green."""
        changed = whole.replace(b"colorLimits", limits)
        (path).write_bytes(as_file(re.sub(rb"(<colorGreenMaximum [^>]*>)255<", rb"\g<1>" + most + b"<", changed)))
        found = read_scan(path, "mm").colors
        assert found is not None and found.dtype == np.uint8
        return found

    np.testing.assert_array_equal(read(b"colorLimits", b"255"), colors)
    half = read(b"colorLimits", b"510")
    np.testing.assert_array_equal(half[:, [0, 2]], colors[:, [0, 2]])
    np.testing.assert_array_equal(half[:, 1], np.round(colors[:, 1] / 2))
    np.testing.assert_array_equal(read(b"colorLimits", b"51")[:, 1], np.minimum(5.0 * colors[:, 1], 255))
    # Limits that are not stated or no limits.
    np.testing.assert_array_equal(read(b"colorLimitz", b"510"), colors)
    np.testing.assert_array_equal(read(b"colorLimits", b"0"), colors)


def test_invalid_colors_of_e57_are_black(
    tmp_path: Path, cloud: tuple[np.ndarray, np.ndarray], colors: np.ndarray
) -> None:
    pytest.importorskip("pye57")
    path, invalid = tmp_path / "cloud.e57", np.arange(500) % 3 == 0
    write_e57(path, cloud[0], colors, intensity=invalid.astype(float))  # pye57 cannot write the field itself
    path.write_bytes(as_file(content_of(path.read_bytes()).replace(b"<intensity ", b"<isColorInvalid ")))
    found = read_scan(path, "mm").colors
    np.testing.assert_array_equal(found, np.where(invalid[:, None], 0, colors))


def test_colors_of_a_reference_are_kept(
    tmp_path: Path, cloud: tuple[np.ndarray, np.ndarray], colors: np.ndarray
) -> None:
    pytest.importorskip("laspy")
    trimesh = pytest.importorskip("trimesh")
    write_las(tmp_path / "cloud.las", *cloud, colors)
    written = trimesh.load(as_ply(read_scan(tmp_path / "cloud.las", "mm"), tmp_path))
    np.testing.assert_array_equal(written.colors[:, :3], colors)


@pytest.mark.parametrize("name", ["scan.las", "scan.e57"])
def test_a_reference_may_be_a_scan(tiny_station_source: Path, tmp_path: Path, name: str) -> None:
    pytest.importorskip("laspy" if name.endswith("las") else "pye57")
    station = tiny_station_source / "station.toml"
    points = _core.read_points(str(malus.Station.load(station).describe()["prior_cloud"]))
    if name.endswith("las"):
        write_las(tmp_path / name, points, np.tile([0.0, 0.0, 1.0], (len(points), 1)))
    else:
        write_e57(tmp_path / name, points)
    outcome = malus_here(
        "assess", station, "-o", tmp_path / "work", "--fusion", "grid", "--reference", tmp_path / name, "--threads", "2"
    )
    assert outcome.code == 0, outcome.err
    reference = malus.Workspace(tmp_path / "work").quality["reference"]
    assert reference["compared_fraction"] > 0.9 and reference["distance_gsd"]["mad"] < 2
    refused = malus_station(station, "-o", tmp_path / "other", "--fusion", "grid", "--reference", tmp_path / name)
    assert (refused.code, "only the Python package reads" in refused.err) == (2, True), refused


def test_a_reference_that_cannot_be_read_takes_no_workspace_over(
    small_station_source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With --replace the workspace already was this station's, and no longer the other's, when the reader was missed."""
    monkeypatch.setitem(sys.modules, "laspy", None)
    (tmp_path / "scan.las").touch()
    outcome = malus_here(
        "run", small_station_source / "station.toml", "-o", tmp_path / "work", "--reference", tmp_path / "scan.las", "--replace"
    )  # fmt: skip
    assert outcome.code == 4 and "needs the Python package laspy" in outcome.err
    assert not (tmp_path / "work").exists()


@pytest.mark.parametrize("name", ["cloud.las", "cloud.e57"])
def test_a_damaged_file_is_named(tmp_path: Path, name: str) -> None:
    pytest.importorskip("laspy")
    pytest.importorskip("pye57")
    (tmp_path / name).write_bytes(b"not a cloud")
    with pytest.raises(malus.InputError, match=name):
        read_scan(tmp_path / name, "mm")


def test_a_damaged_page_of_an_e57_file_is_named(tmp_path: Path, cloud: tuple[np.ndarray, np.ndarray]) -> None:
    pytest.importorskip("pye57")
    write_e57(tmp_path / "cloud.e57", cloud[0])
    content = bytearray((tmp_path / "cloud.e57").read_bytes())
    content[2048] ^= 0xFF  # among the points; every page of 1024 bytes has a checksum
    (tmp_path / "cloud.e57").write_bytes(content)
    with pytest.raises(malus.InputError, match=r"cloud\.e57: is not a cloud that can be read"):
        read_scan(tmp_path / "cloud.e57", "mm")


def written_e57(folder: Path, points: np.ndarray) -> tuple[Path, bytes]:
    """An E57 file of these points, and its content without the checksums of its pages."""
    pytest.importorskip("pye57")
    write_e57(folder / "cloud.e57", points)
    return folder / "cloud.e57", content_of((folder / "cloud.e57").read_bytes())


def test_points_that_an_e57_file_counts_but_does_not_hold_are_refused(
    tmp_path: Path, cloud: tuple[np.ndarray, np.ndarray]
) -> None:
    """They were whatever the memory held before."""
    path, whole = written_e57(tmp_path, cloud[0])
    path.write_bytes(as_file(whole))
    np.testing.assert_allclose(read_scan(path, "mm")[0], cloud[0], atol=1e-4)
    for count, said in ((b"501", "holds 500"), (b"987654321098", "more than the file has room for")):
        path.write_bytes(as_file(whole.replace(b'recordCount="500"', b'recordCount="%b"' % count)))
        with pytest.raises(malus.InputError, match=f"counts {count.decode()} points, .*{said}"):
            read_scan(path, "mm")


def test_a_scan_without_all_coordinates_or_with_no_rotation_is_named(
    tmp_path: Path, cloud: tuple[np.ndarray, np.ndarray]
) -> None:
    """The first ended with an error of its own."""
    path, whole = written_e57(tmp_path, cloud[0])
    path.write_bytes(as_file(whole.replace(b"cartesianZ", b"cartesianW")))
    with pytest.raises(malus.InputError, match=r"cloud\.e57: .*no coordinates"):
        read_scan(path, "mm")
    write_e57_with_normals(path, *cloud, np.zeros(len(cloud[0])))
    whole = content_of(path.read_bytes())
    path.write_bytes(as_file(re.sub(rb">7\.07\d*e-0?1<", b">0<", whole)))
    with pytest.raises(malus.InputError, match=r"cloud\.e57: .*no rotation"):
        read_scan(path, "mm")


_PROTOTYPE = rb"<prototype.*?</prototype>"
_VECTOR = b'<q:other type="Vector" allowHeterogeneousChildren="%b">%b</q:other></e57Root>'
_POINTS = b'<vectorChild type="CompressedVector" fileOffset="48" recordCount="0">%b</vectorChild>'
_FIELDS, _CODECS = b'<prototype type="Structure"/>', b'<codecs type="Vector" allowHeterogeneousChildren="1"/>'


def changed_xml(content: bytes, *changes: tuple[bytes, bytes]) -> bytes:
    """The content of an E57 file up to the end of its XML, with a prefix q, and parts of the XML replaced."""
    content = content[: content.rindex(b"</e57Root>")] + b"</e57Root>"
    for pattern, replacement in ((b"<e57Root", b'<e57Root xmlns:q="https://example.org/q"'), *changes):
        content, count = re.subn(pattern, replacement, content, flags=re.DOTALL)
        assert count
    return content


@pytest.mark.parametrize(
    "changes",
    [
        [(_PROTOTYPE, b"")],
        [(rb"(<points[^>]*)>.*?</points>", rb"\1/>")],
        [(_PROTOTYPE, b""), (b"vectorChild", b"q:scan")],
        [(_PROTOTYPE, b""), (rb"<data3D[^>]*>", b'<data3D type="Structure">')],
        [
            (b"<codecs.*?(</codecs>|/>)", b""),
            (rb"<data3D[^>]*>(.*?)</data3D>", rb'<data3D type="Vector">\1\1</data3D>'),
        ],
        [(b"</e57Root>", _VECTOR % (b"0", 2 * (_POINTS % b"")))],
        [(b"</e57Root>", _VECTOR % (b"0", 2 * (_POINTS % _FIELDS)))],
        [(b"</e57Root>", _VECTOR % (b"0", 2 * (_POINTS % _CODECS)))],
    ],
    ids=["removed", "no children", "prefixed scan", "no vector", "no codecs", "nothing", "only fields", "only codecs"],
)
@pytest.mark.parametrize("zeros", [0, 8])
def test_e57_files_that_ended_the_program_are_refused(
    tmp_path: Path, cloud: tuple[np.ndarray, np.ndarray], changes: list[tuple[bytes, bytes]], zeros: int
) -> None:
    """Signal 11 in libE57, also where zeros behind the XML count as XML."""
    path, whole = written_e57(tmp_path, cloud[0])
    path.write_bytes(as_file(changed_xml(whole, *changes) + bytes(zeros), zeros))
    with pytest.raises(malus.InputError, match=r"cloud\.e57: .*do not say which fields they have"):
        read_scan(path, "mm")


@pytest.mark.parametrize(
    "changes",
    [
        [],
        [
            (b"</e57Root>", b"<q:other>%b</q:other></e57Root>" % (_POINTS % b"")),
            (b"<q:other", b'<q:other type="Structure"'),
        ],
        [(b"</e57Root>", _VECTOR % (b"1", 2 * (_POINTS % b"")))],
        [(b"</e57Root>", _VECTOR % (b"0", 2 * (_POINTS % (_FIELDS + _CODECS))))],
    ],
    ids=["no extension", "no prototype", "not alike", "alike"],
)
@pytest.mark.parametrize("zeros", [0, 8])
def test_extensions_of_an_e57_file_and_zeros_behind_its_xml_do_not_matter(
    tmp_path: Path, cloud: tuple[np.ndarray, np.ndarray], changes: list[tuple[bytes, bytes]], zeros: int
) -> None:
    """Files that libE57 reads."""
    path, whole = written_e57(tmp_path, cloud[0])
    path.write_bytes(as_file(changed_xml(whole, *changes) + bytes(zeros), zeros))
    np.testing.assert_allclose(read_scan(path, "mm")[0], cloud[0], atol=1e-4)


@pytest.mark.parametrize(
    ("pattern", "replacement", "said"),
    [
        (_PROTOTYPE, _FIELDS, "a scan has no coordinates"),
        (b"(</?)prototype", rb"\1q:prototype", "do not say which fields they have"),
        (b"(</?)points", rb"\1q:points", "not defined"),
        (b"</e57Root>", 100 * b"<q:a>" + 100 * b"</q:a>" + b"</e57Root>", "more than 100 elements within each other"),
        (b"<e57Root", b"<!DOCTYPE e57Root []><e57Root", "has a document type"),
        (b"</points>", b"", "mismatched tag"),
    ],
)
def test_other_xml_that_is_no_e57_file_is_refused(
    tmp_path: Path, cloud: tuple[np.ndarray, np.ndarray], pattern: bytes, replacement: bytes, said: str
) -> None:
    path, whole = written_e57(tmp_path, cloud[0])
    path.write_bytes(as_file(changed_xml(whole, (pattern, replacement))))
    with pytest.raises(malus.InputError, match=rf"cloud\.e57: .*{said}"):
        read_scan(path, "mm")


def test_the_xml_of_an_e57_file_takes_no_memory_before_it_is_read(
    tmp_path: Path, cloud: tuple[np.ndarray, np.ndarray]
) -> None:
    """A tree of it took 27 bytes a byte."""
    path, whole = written_e57(tmp_path, cloud[0])
    many = b'<q:a type="Integer"/>' * 100_000
    path.write_bytes(as_file(changed_xml(whole, (b"</e57Root>", many + b"</e57Root>"))))
    tracemalloc.start()
    require_fields_of_points(path)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 3 * len(many)


def test_a_scan_may_be_in_spherical_coordinates(tmp_path: Path) -> None:
    pye57 = pytest.importorskip("pye57")
    file = pye57.E57(str(tmp_path / "cloud.e57"), mode="w")
    image = file.image_file
    prototype, scan = pye57.libe57.StructureNode(image), pye57.libe57.StructureNode(image)
    values = {
        "sphericalRange": [2.0, 3.0],
        "sphericalAzimuth": [0.0, np.pi / 2],
        "sphericalElevation": [0.0, np.pi / 6],
    }
    buffers = pye57.libe57.VectorSourceDestBuffer()
    arrays = {name: np.array(value) for name, value in values.items()}
    for name, array in arrays.items():
        prototype.set(name, pye57.libe57.FloatNode(image, 0.0, pye57.libe57.E57_DOUBLE, -10.0, 10.0))
        buffers.append(pye57.libe57.SourceDestBuffer(image, name, array, len(array), True, True))
    points = pye57.libe57.CompressedVectorNode(image, prototype, pye57.libe57.VectorNode(image, True))
    scan.set("points", points)
    file.data3d.append(scan)
    writer = points.writer(buffers)
    writer.write(2)
    writer.close()
    file.close()
    found, *_ = read_scan(tmp_path / "cloud.e57", "m")
    np.testing.assert_allclose(found, [[2, 0, 0], [0, 3 * 0.75**0.5, 1.5]], atol=1e-12)


@pytest.mark.parametrize("name", ["cloud.las", "cloud.laz"])
def test_a_las_file_that_is_cut_short_is_refused(
    tmp_path: Path, cloud: tuple[np.ndarray, np.ndarray], name: str
) -> None:
    """One that lacked whole points was read without them; a LAZ file ended the process if the package laszip was there."""
    pytest.importorskip("laspy")
    pytest.importorskip("lazrs")
    path = tmp_path / name
    write_las(path, *cloud)
    whole = path.read_bytes()
    for length in (len(whole) - 42, len(whole) // 2):  # a point has 42 bytes in the LAS file
        path.write_bytes(whole[:length])
        with pytest.raises(malus.InputError, match=path.name):
            read_scan(path, "mm")


def test_laz_headers_that_ask_for_memory_are_refused(tmp_path: Path) -> None:
    """A few KB could state millions of points, or points of any length, which the decoder allocates at once."""
    pytest.importorskip("laspy")
    pytest.importorskip("lazrs")
    path = tmp_path / "cloud.laz"
    write_las(path, np.zeros((50, 3)), np.zeros((50, 3)))
    whole = bytearray(path.read_bytes())
    damaged = whole.copy()
    damaged[247:255] = (1_000_000).to_bytes(8, "little")
    path.write_bytes(damaged)
    with pytest.raises(malus.InputError, match="counts 1000000 points, more than"):
        read_scan(path, "mm")
    # The record of the decoder: user (16 bytes), number, length (2 bytes each), description (32), then the decoder's data, which
    # list the items of a point (type, size and version, of 2 bytes each) from their byte 34 on.
    items = whole.index(b"laszip encoded") + 16 + 2 + 2 + 32 + 34
    damaged = whole.copy()
    damaged[items + 2 : items + 4] = b"\xff\xff"
    path.write_bytes(damaged)
    with pytest.raises(malus.InputError, match="by one header"):
        read_scan(path, "mm")


def test_a_laz_file_that_ends_its_decoder_is_refused(tmp_path: Path, cloud: tuple[np.ndarray, np.ndarray]) -> None:
    """Its table counts billions of parts: the decoder asked for that memory and ended the process, with signal 6."""
    pytest.importorskip("laspy")
    pytest.importorskip("lazrs")
    path = tmp_path / "cloud.laz"
    write_las(path, *cloud)
    whole = bytearray(path.read_bytes())
    start = int.from_bytes(whole[96:100], "little")  # of the points, before which the place of the table stands
    table = int.from_bytes(whole[start : start + 8], "little")
    whole[table + 4 : table + 8] = b"\xff\xff\xff\xff"
    path.write_bytes(whole)
    with pytest.raises(malus.InputError, match=r"cloud\.laz"):
        read_scan(path, "mm")


def test_a_laz_file_takes_no_memory_that_its_size_does_not_explain(
    tmp_path: Path, cloud: tuple[np.ndarray, np.ndarray]
) -> None:
    """One of its layers states gigabytes: the decoder filled them with zeros, which took seconds."""
    pytest.importorskip("laspy")
    pytest.importorskip("lazrs")
    path = tmp_path / "cloud.laz"
    write_las(path, *cloud)
    whole = bytearray(path.read_bytes())
    start, length = int.from_bytes(whole[96:100], "little"), int.from_bytes(whole[105:107], "little")
    # The place of the table, the first point, the number of points; then the sizes of the layers.
    sizes = start + 8 + length + 4
    whole[sizes + 20 : sizes + 24] = (0x7F000000).to_bytes(4, "little")
    path.write_bytes(whole)
    with pytest.raises(malus.InputError, match=r"cloud\.laz: .*memory allocation of 2130706432 bytes failed"):
        read_scan(path, "mm")


def test_points_that_are_not_finite_are_refused(tmp_path: Path, cloud: tuple[np.ndarray, np.ndarray]) -> None:
    """As in PLY and text. The message names the user's file, not one that was made of it."""
    pytest.importorskip("pye57")
    points = cloud[0].copy()
    points[7, 1] = np.nan
    write_e57_with_normals(tmp_path / "cloud.e57", points, cloud[1], np.zeros(len(points)))
    with pytest.raises(malus.InputError, match=r"cloud\.e57: 1 of 500 points have coordinates that are not finite"):
        read_scan(tmp_path / "cloud.e57", "mm")


@pytest.mark.parametrize("name", ["pipe.las", "pipe.e57"])
def test_a_pipe_is_no_scan(tmp_path: Path, name: str) -> None:
    """It was waited for, for ever."""
    pytest.importorskip("laspy")
    pytest.importorskip("pye57")
    os.mkfifo(tmp_path / name)
    with pytest.raises(malus.InputError, match="not a regular file"):
        read_scan(tmp_path / name, "mm")


def test_las_headers_that_count_more_than_the_file_holds_are_refused(
    tmp_path: Path, cloud: tuple[np.ndarray, np.ndarray]
) -> None:
    """The reader neither reads billions of records or points nor allocates memory for them."""
    write_las(tmp_path / "cloud.las", *cloud)
    whole = bytearray((tmp_path / "cloud.las").read_bytes())
    for offset, word in ((100, "records"), (107, "points")):
        damaged = whole.copy()
        damaged[offset : offset + 4] = b"\xff\xff\xff\xff"
        (tmp_path / "damaged.las").write_bytes(damaged)
        with pytest.raises(malus.InputError, match=f"counts 4294967295 {word}"):
            read_scan(tmp_path / "damaged.las", "mm")


def test_a_las_file_that_ends_within_its_count_takes_no_memory(
    tmp_path: Path, cloud: tuple[np.ndarray, np.ndarray]
) -> None:
    write_las(tmp_path / "cloud.las", *cloud)
    header = bytearray((tmp_path / "cloud.las").read_bytes()[:250])
    header[100:111] = bytes(5) + (10_000).to_bytes(2, "little") + bytes(4)
    header[247:250] = b"\xff\xff\xff"
    (tmp_path / "cut.las").write_bytes(header)
    with pytest.raises(malus.InputError, match="counts 16777215 points, more than the file has room for"):
        read_scan(tmp_path / "cut.las", "mm")


def test_an_extended_record_of_las_takes_no_memory(tmp_path: Path) -> None:
    """It may state any length, for which the reader allocated memory before it read the file."""
    laspy = pytest.importorskip("laspy")
    las = laspy.create(point_format=6, file_version="1.4")
    las.x = las.y = las.z = np.arange(3.0)
    las.write(str(tmp_path / "cloud.las"))
    content = bytearray((tmp_path / "cloud.las").read_bytes())
    content[235:243] = len(content).to_bytes(8, "little")
    content[243:247] = (1).to_bytes(4, "little")
    record = bytes(20) + (1 << 50).to_bytes(8, "little") + bytes(32)
    (tmp_path / "cloud.las").write_bytes(content + record)
    points, *_ = read_scan(tmp_path / "cloud.las", "m")
    assert np.allclose(points, np.arange(3.0)[:, None])


def test_a_station_with_a_las_prior_equals_that_with_its_ply(small_station: Path, tmp_path: Path) -> None:
    pytest.importorskip("laspy")
    text = small_station.read_text()
    name = next(line.split('"')[1] for line in text.splitlines() if line.startswith("cloud"))
    vertices = malus._core.read_points(str(small_station.parent / name))
    write_las(small_station.parent / "cloud.las", vertices, np.zeros_like(vertices))
    las_station = small_station.with_name("las.toml")
    las_station.write_text(text.replace(name, "cloud.las"))
    las = malus.reconstruct(malus.Station.load(las_station), until="prior").prior_depth
    assert las is not None
    np.savetxt(small_station.parent / "cloud.xyz", vertices, "%.6f")
    xyz_station = small_station.with_name("xyz.toml")
    xyz_station.write_text(text.replace(name, "cloud.xyz"))
    xyz = malus.reconstruct(malus.Station.load(xyz_station), until="prior").prior_depth
    np.testing.assert_allclose(las, xyz, rtol=1e-5)  # LAS rounds to its scale
    refused = malus_station(las_station, "-o", tmp_path / "work")
    assert refused.code == 2
    assert "malus run" in refused.err


@pytest.mark.parametrize("name", ["cloud.las", "cloud.e57"])
def test_colors_of_a_scan_are_compared_with_the_images(tiny_station: Path, tmp_path: Path, name: str) -> None:
    """As those of the same cloud as a text; only phases were."""
    pytest.importorskip("laspy" if name.endswith("las") else "pye57")

    def figures() -> list[float]:
        malus.reconstruct(malus.Station.load(tiny_station), until="evidence", workspace=tmp_path / "work", threads=2)
        found = {finding["check"]: finding["figures"] for finding in malus.Workspace(tmp_path / "work").findings}
        return [found["prior"]["color_as_given"], found["contrast"]["contrast"]]

    folder, cloud = tiny_station.parent, cloud_of(tiny_station)
    points, colors = cloud["xyz"].astype(float), cloud["color"]
    np.savetxt(folder / "cloud.xyz", np.hstack([points, colors]), "%.6f")
    if name.endswith("las"):
        write_las(folder / name, points, np.zeros_like(points), colors)
    else:
        write_e57(folder / name, points, colors)
    edit(tiny_station, "dense/cloud.ply", "cloud.xyz")
    expected = figures()
    edit(tiny_station, "cloud.xyz", name)
    assert figures() == pytest.approx(expected, rel=1e-3)


def test_the_archive_has_the_scan_that_the_surface_was_made_from(small_station: Path, tmp_path: Path) -> None:
    pytest.importorskip("laspy")
    pytest.importorskip("rocrate")
    cloud = small_station.parent / "cloud.las"
    vertices = malus._core.read_points(str(small_station.parent / "dense/cloud.ply"))
    unknown = np.zeros_like(vertices)
    write_las(cloud, vertices, unknown)
    edit(small_station, "dense/cloud.ply", "cloud.las")
    work = tmp_path / "work"
    malus.reconstruct(malus.Station.load(small_station), malus.Options(fusion="grid"), workspace=work)
    with zipfile.ZipFile(malus.export(work, "archive")) as file:
        assert file.read("small/data/inputs/cloud.las") == cloud.read_bytes()
    assert malus.Workspace(work).manifest["inputs"]["cloud.las"] == sha256_of(cloud)
    for points, normals in ((vertices + [1e-3, 0, 0], unknown), (vertices, unknown + [0, 0, 1])):
        write_las(cloud, points, normals)
        with pytest.raises(malus.InputError, match=r"cloud\.las: was changed since"):
            malus.export(work, "archive")
