"""Clouds in LAS and E57 as a prior and as a reference."""

from __future__ import annotations

import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

import malus
from conftest import edit, malus_here, malus_station
from malus import _core
from malus.scans import read_scan


@pytest.fixture
def cloud() -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(4)
    normals = random.normal(size=(500, 3))
    return random.uniform(-20, 20, (500, 3)), normals / np.linalg.norm(normals, axis=1)[:, None]


def write_las(path: Path, points: np.ndarray, normals: np.ndarray) -> None:
    import laspy

    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales = np.full(3, 1e-5)
    for name in ("normal_x", "normal_y", "normal_z"):
        header.add_extra_dim(laspy.ExtraBytesParams(name=name, type=np.float32))
    data = laspy.LasData(header)
    data.x, data.y, data.z = points.T
    data.normal_x, data.normal_y, data.normal_z = normals.T.astype(np.float32)
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


def write_e57(path: Path, points_mm: np.ndarray) -> None:
    import pye57

    file = pye57.E57(str(path), mode="w")
    x, y, z = points_mm.T * 1e-3
    turned = np.array([np.cos(0.2), 0, 0, np.sin(0.2)])  # about z
    inverse = np.array([[np.cos(0.4), np.sin(0.4), 0], [-np.sin(0.4), np.cos(0.4), 0], [0, 0, 1]])
    local = (np.stack([x, y, z], axis=1) - np.array([0.5, 0, 0])) @ inverse.T
    file.write_scan_raw(
        {"cartesianX": local[:, 0].copy(), "cartesianY": local[:, 1].copy(), "cartesianZ": local[:, 2].copy()},
        rotation=turned,
        translation=np.array([0.5, 0, 0]),
    )
    file.close()


def test_las_has_points_and_normals(tmp_path: Path, cloud: tuple[np.ndarray, np.ndarray]) -> None:
    pytest.importorskip("laspy")
    write_las(tmp_path / "cloud.las", *cloud)
    points, normals = read_scan(tmp_path / "cloud.las", "mm")
    np.testing.assert_allclose(points, cloud[0], atol=1e-5)
    assert normals is not None
    np.testing.assert_allclose(normals, cloud[1], atol=1e-6)


def test_e57_is_in_meters_and_in_its_common_frame(tmp_path: Path, cloud: tuple[np.ndarray, np.ndarray]) -> None:
    pytest.importorskip("pye57")
    write_e57(tmp_path / "cloud.e57", cloud[0])
    points, normals = read_scan(tmp_path / "cloud.e57", "mm")
    np.testing.assert_allclose(points, cloud[0], atol=1e-4)
    assert normals is None


def test_e57_with_normals_is_read_with_them(tmp_path: Path, cloud: tuple[np.ndarray, np.ndarray]) -> None:
    """Such files were refused: their normals are fields that the library's own reader does not know."""
    pytest.importorskip("pye57")
    invalid = np.arange(len(cloud[0])) % 5 == 2
    write_e57_with_normals(tmp_path / "cloud.e57", *cloud, 2 * invalid)
    points, normals = read_scan(tmp_path / "cloud.e57", "mm")
    assert normals is not None
    np.testing.assert_allclose(points, cloud[0][~invalid], atol=1e-9)
    np.testing.assert_allclose(normals, cloud[1][~invalid], atol=1e-6)


def test_normals_of_a_scan_have_length_1_or_0(tmp_path: Path, cloud: tuple[np.ndarray, np.ndarray]) -> None:
    pytest.importorskip("laspy")
    given = 3 * cloud[1]
    given[0], given[1] = 0, np.nan
    write_las(tmp_path / "cloud.las", cloud[0], given)
    _, normals = read_scan(tmp_path / "cloud.las", "mm")
    assert normals is not None
    np.testing.assert_allclose(normals[2:], cloud[1][2:], atol=1e-6)
    np.testing.assert_array_equal(normals[:2], 0)


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


def test_the_archive_has_the_scan_that_the_surface_was_made_from(small_station: Path, tmp_path: Path) -> None:
    laspy = pytest.importorskip("laspy")
    pytest.importorskip("rocrate")
    cloud = small_station.parent / "cloud.las"
    vertices = malus._core.read_points(str(small_station.parent / "dense/cloud.ply"))
    scan = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    scan.header.offsets, scan.header.scales = vertices.mean(0), [1e-4] * 3
    scan.x, scan.y, scan.z = vertices.T
    scan.write(cloud)
    edit(small_station, "dense/cloud.ply", "cloud.las")
    work = tmp_path / "work"
    malus.reconstruct(malus.Station.load(small_station), malus.Options(fusion="grid"), workspace=work)
    with zipfile.ZipFile(malus.export(work, "archive")) as file:
        assert file.read("small/data/inputs/cloud.las") == cloud.read_bytes()
    moved = laspy.read(cloud)
    moved.X[0] += 1
    moved.write(cloud)
    with pytest.raises(malus.InputError, match=r"cloud\.las: was changed since"):
        malus.export(work, "archive")
