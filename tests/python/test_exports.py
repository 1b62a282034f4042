"""Exports, each read back by a third-party program or library."""

from __future__ import annotations

import json
import os
import re
import shutil
import struct
import sys
import threading
import time
import tracemalloc
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

import malus
from conftest import ROOT, malus_here, malus_station, run_program
from conftest import malus as run_malus
from malus import _core, drawings, exported, exports, rti, scans, xmp
from malus._files import read_record
from malus.exports import maps
from malus.object import arrays
from malus.raster import sample
from malus.rti import write_ptm
from malus.trust import said_of
from malus.xmp import NAMESPACE, srgb_profile


@pytest.fixture(scope="module")
def workspace(finished_grid: Path) -> malus.Workspace:
    return malus.Workspace(finished_grid)


@pytest.fixture(scope="module")
def points(workspace: malus.Workspace) -> np.ndarray:
    """World points of all pixels by the formula of docs/conventions.md, H×W×3."""
    camera, (rotation, translation) = workspace.camera, workspace.pose
    depth = workspace.raster("fused/depth.tif").astype(float)
    v, u = np.indices(depth.shape)
    in_camera = np.stack([(u - camera.cx) / camera.fx * depth, (v - camera.cy) / camera.fy * depth, depth], -1)
    return (in_camera - translation) @ rotation


def assert_on_surface(vertices: np.ndarray, workspace: malus.Workspace, largest: float, median: float) -> None:
    """The vertices' depths differ from the depth map by less than `largest`, and by less than `median` in the median."""
    camera, (rotation, translation) = workspace.camera, workspace.pose
    x, y, z = (vertices @ rotation.T + translation).T
    pixels = np.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], -1)
    depth = workspace.raster("fused/depth.tif")[..., None]
    error = np.abs(sample(depth, pixels)[:, 0] - z)
    assert error.max() < largest
    assert np.median(error) < median


def load_scene(path: Path):  # type: ignore[no-untyped-def]
    trimesh = pytest.importorskip("trimesh")
    loaded = trimesh.load(path)
    return next(iter(loaded.geometry.values())) if hasattr(loaded, "geometry") else loaded, loaded


def test_glb_of_the_run_is_textured_and_in_meters_of_the_world_frame(
    finished_grid: Path, workspace: malus.Workspace, points: np.ndarray
) -> None:
    mesh, scene = load_scene(finished_grid / "fused/surface.glb")
    matrix, _ = scene.graph[scene.graph.nodes_geometry[0]]
    vertices = (mesh.vertices @ matrix[:3, :3].T + matrix[:3, 3]) * 1000
    assert len(vertices) == points.shape[0] * points.shape[1]
    np.testing.assert_allclose(vertices, points.reshape(-1, 3), atol=1e-4)
    texture = mesh.visual.material.baseColorTexture
    assert texture.size == (200, 160)
    v, u = np.indices((160, 200))
    # trimesh flips glTF's v.
    np.testing.assert_allclose(mesh.visual.uv[:, 0], (u.ravel() + 0.5) / 200, atol=1e-5)
    np.testing.assert_allclose(mesh.visual.uv[:, 1], 1 - (v.ravel() + 0.5) / 160, atol=1e-5)
    colors = np.asarray(mesh.visual.to_color().vertex_colors)[:, :3].astype(float)
    expected = exports.Exporter(workspace).picture().reshape(-1, 3).astype(float)
    assert np.corrcoef(colors.mean(1), expected.mean(1))[0, 1] > 0.9
    normals = np.asarray(mesh.vertex_normals)
    assert (normals @ workspace.pose[0][2] < 0).mean() > 0.999


def test_glb_camera_looks_from_the_station(finished_grid: Path, workspace: malus.Workspace) -> None:
    content = (finished_grid / "fused/surface.glb").read_bytes()
    document = json.loads(content[20 : 20 + int.from_bytes(content[12:16], "little")])
    node = next(node for node in document["nodes"] if "camera" in node)
    world_from_gl = np.array(node["matrix"]).reshape(4, 4).T
    rotation, translation = workspace.pose
    np.testing.assert_allclose(world_from_gl[:3, 3] * 1000, -rotation.T @ translation, rtol=1e-9)
    np.testing.assert_allclose(world_from_gl[:3, 2], -rotation[2], atol=1e-9)


def test_dem_of_the_run_is_a_geotiff_of_the_surface(finished_grid: Path, workspace: malus.Workspace) -> None:
    rasterio = pytest.importorskip("rasterio")
    with rasterio.open(finished_grid / "fused/dem.tif") as file:
        elevation, transform, tags, crs = file.read(1), file.transform, file.tags(), file.crs
        assert np.isnan(file.nodata) and file.units == ("mm",)
    assert "millimetre" in crs.to_wkt() and not crs.is_geographic and not crs.is_projected
    frame = {
        name: np.array([float(x) for x in tags[f"WORLD_{name}"].split()])
        for name in ("ORIGIN", "X_AXIS", "Y_AXIS", "Z_AXIS")
    }
    rows, columns = np.nonzero(np.isfinite(elevation))
    assert len(rows) > 0.9 * elevation.size
    x = transform.c + transform.a * (columns + 0.5)
    y = transform.f + transform.e * (rows + 0.5)
    world = frame["ORIGIN"] + np.multiply.outer(x, frame["X_AXIS"]) + np.multiply.outer(y, frame["Y_AXIS"])
    world += np.multiply.outer(elevation[rows, columns].astype(float), frame["Z_AXIS"])
    gsd = workspace.quality["gsd"]
    # A shift of half a pixel would show in the median.
    assert_on_surface(world, workspace, gsd, 0.02 * gsd)
    assert abs(np.nanmedian(elevation)) < 3


def test_dem_written_from_python_equals_that_of_the_run(workspace: malus.Workspace, tmp_path: Path) -> None:
    dem = exports.Exporter(workspace).dem()
    malus.surface.write_dem(tmp_path / "dem.tif", dem, unit="mm", name="small")
    assert (tmp_path / "dem.tif").read_bytes() == workspace.path("fused/dem.tif").read_bytes()
    with pytest.raises(malus.InputError, match="furlong"):
        malus.surface.write_dem(tmp_path / "other.tif", dem, unit="furlong", name="small")


def test_an_elevation_model_that_the_run_left_out_is_told_with_its_reason(
    workspace: malus.Workspace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reason = "no fused/dem.tif: its plane is seen edge-on"
    monkeypatch.delitem(workspace.outputs, "fused/dem.tif")
    monkeypatch.setitem(workspace.quality, "warnings", [reason])
    with pytest.raises(malus.InputError, match=reason):
        maps.export_dem(exports.Exporter(workspace), tmp_path / "dem.tif")
    assert not (tmp_path / "dem.tif").exists()


def test_obj_reads_back_with_its_texture(workspace: malus.Workspace, points: np.ndarray, tmp_path: Path) -> None:
    path = malus.export(workspace.folder, "obj", tmp_path / "a.obj")
    mesh, _ = load_scene(path)
    np.testing.assert_allclose(mesh.bounds, [points.min((0, 1)), points.max((0, 1))], atol=1e-4)
    assert len(mesh.faces) > 60000
    assert mesh.visual.material.image.size == (200, 160)
    assert {p.name for p in tmp_path.iterdir()} == {"a.obj", "a.mtl", "a.png"}
    # Left of the texture is left of the station's image.
    camera, (rotation, translation) = workspace.camera, workspace.pose
    x, _, z = (np.asarray(mesh.vertices) @ rotation.T + translation).T
    np.testing.assert_allclose(mesh.visual.uv[:, 0], (camera.fx * x / z + camera.cx + 0.5) / 200, atol=1e-4)


def test_obj_names_its_files_without_spaces(workspace: malus.Workspace, tmp_path: Path) -> None:
    """Readers that take a space for the end of a name (tinyobjloader and what is built on it) found no texture."""
    path = malus.export(workspace.folder, "obj", tmp_path / "Stone  of 1907.v2.obj")
    beside = {"Stone_of_1907.v2.mtl", "Stone_of_1907.v2.png"}
    assert {p.name for p in tmp_path.iterdir()} == {path.name, *beside}
    assert "\nmtllib Stone_of_1907.v2.mtl\n" in path.read_text(encoding="utf-8")
    assert "\nmap_Kd Stone_of_1907.v2.png\n" in (tmp_path / "Stone_of_1907.v2.mtl").read_text(encoding="utf-8")
    before = (tmp_path / "Stone_of_1907.v2.png").read_bytes()
    with pytest.raises(malus.InputError, match=r"Stone_of_1907\.v2\.png would replace that of Stone  of 1907\.v2\.obj"):
        malus.export(workspace.folder, "obj", tmp_path / "Stone_of_1907.v2.obj")
    assert (tmp_path / "Stone_of_1907.v2.png").read_bytes() == before
    malus.export(workspace.folder, "obj", path)  # itself again


@pytest.mark.parametrize("format", ["obj", "stl"])
def test_large_meshes_are_written_in_parts(
    workspace: malus.Workspace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, format: str
) -> None:
    """At 100 megapixels, copies of all triangles took 15 GB (OBJ) and more than 40 GB (STL) beside the mesh."""
    write, exporter = exports.FORMATS[format][0], exports.Exporter(workspace)
    mesh = exporter.mesh()
    monkeypatch.setattr(exports.Exporter, "simplified", lambda *_: mesh)
    whole, parts = (tmp_path / name / f"a.{format}" for name in ("whole", "parts"))
    write(exporter, whole)
    monkeypatch.setattr(arrays, "CHUNK", 1000)
    tracemalloc.start()
    try:
        write(exporter, parts)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert parts.read_bytes() == whole.read_bytes()
    assert most < 0.5 * parts.stat().st_size


@pytest.mark.parametrize("format", ["orthophoto", "normal-map"])
def test_large_maps_are_computed_in_parts(
    workspace: malus.Workspace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, format: str
) -> None:
    """At 100 megapixels, the places of all pixels and what was seen there took tens of GB."""
    from PIL import Image

    write, exporter = exports.FORMATS[format][0], exports.Exporter(workspace)
    dem = exporter.dem()
    monkeypatch.setattr(exports.Exporter, "dem", lambda _: dem)
    write(exporter, tmp_path / "whole.png")
    monkeypatch.setattr(arrays, "CHUNK", 1000)
    tracemalloc.start()
    try:
        write(exporter, tmp_path / "parts.png")
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most < 80 * dem.elevation.size
    read = {"orthophoto": lambda path: np.asarray(Image.open(path)), "normal-map": sixteen_bits}[format]
    whole, parts = (read(tmp_path / f"{name}.png").astype(int) for name in ("whole", "parts"))
    assert np.abs(whole - parts).max() <= 1  # by rounding
    rows = slice(20, 33)
    np.testing.assert_array_equal(dem.points(rows), dem.points()[rows])


def test_cloudcompare_opens_meshes_and_measures_between_them(
    workspace: malus.Workspace, points: np.ndarray, tmp_path: Path
) -> None:
    pytest.importorskip("fast_simplification")
    program = shutil.which("CloudCompare")
    if program is None:
        pytest.skip("CloudCompare is not installed (apt install cloudcompare)")
    malus.export(workspace.folder, "obj", tmp_path / "full.obj")
    malus.export(workspace.folder, "ply", tmp_path / "few.ply", faces=5000)
    # Distances of the vertices of the first mesh to the triangles of the second, as text: x y z … distance nx ny nz.
    outcome = run_program(
        program, "-SILENT", "-AUTO_SAVE", "OFF", "-C_EXPORT_FMT", "ASC", "-PREC", "9", "-ADD_HEADER",
        "-O", "full.obj", "-EXTRACT_VERTICES", "-O", "few.ply", "-C2M_DIST", "-SAVE_CLOUDS", "FILE", "distances.asc",
        cwd=tmp_path, env={**os.environ, "QT_QPA_PLATFORM": "offscreen"},
    )  # fmt: skip
    assert outcome.code == 0 and "32000 points" in outcome.out + outcome.err, outcome
    header, *_ = (tmp_path / "distances.asc").read_text().splitlines()
    columns = header.removeprefix("//").split()
    values = np.loadtxt(tmp_path / "distances.asc", comments="//")
    np.testing.assert_allclose(values[:, :3], points.reshape(-1, 3), atol=1e-4)
    distance = values[:, next(i for i, name in enumerate(columns) if "distances" in name)]
    gsd = workspace.quality["gsd"]
    # With a twelfth of the triangles the surface is not the same but close, except where corners were cut off.
    assert 0.005 * gsd < np.abs(distance).mean() < 0.3 * gsd
    assert np.percentile(np.abs(distance), 99) < 2 * gsd


def test_meshes_with_fewer_faces_stay_on_the_surface(workspace: malus.Workspace, tmp_path: Path) -> None:
    pytest.importorskip("fast_simplification")
    gsd = workspace.quality["gsd"]
    for name, scale in (("ply", 1), ("glb", 1000)):
        path = malus.export(workspace.folder, name, tmp_path / f"a.{name}", faces=5000)
        mesh, scene = load_scene(path)
        vertices = np.asarray(mesh.vertices)
        if name == "glb":
            matrix, _ = scene.graph[scene.graph.nodes_geometry[0]]
            vertices = (vertices + matrix[:3, 3]) * scale
        assert 4000 < len(mesh.faces) <= 5000
        assert_on_surface(vertices, workspace, 4 * gsd, 0.2 * gsd)
        assert (np.asarray(mesh.vertex_normals) @ workspace.pose[0][2] < 0).mean() > 0.99


def sixteen_bits(path: Path) -> np.ndarray:
    """H×W×3 of a 16-bit picture, read by GDAL."""
    rasterio = pytest.importorskip("rasterio")
    with warnings.catch_warnings():
        # These pictures are rightly not georeferenced.
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        file = rasterio.open(path)
    with file:
        assert file.dtypes == ("uint16",) * 3
        return np.moveaxis(file.read(), 0, -1)


def test_normal_map_is_opengl_and_displacement_fits_it(workspace: malus.Workspace, tmp_path: Path) -> None:
    png = sixteen_bits(malus.export(workspace.folder, "normal-map", tmp_path / "n.png")) / 65535 * 2 - 1
    with tifffile.TiffFile(malus.export(workspace.folder, "normal-map", tmp_path / "n.tif")) as tiff:
        words = tiff.pages[0].asarray()
        assert tiff.pages[0].photometric == tifffile.PHOTOMETRIC.RGB
    assert words.dtype == np.uint16
    np.testing.assert_array_equal(sixteen_bits(tmp_path / "n.tif"), words)
    library = pytest.importorskip("OpenEXR")
    with library.File(str(malus.export(workspace.folder, "normal-map", tmp_path / "n.exr"))) as file:
        floats = file.channels()["RGB"].pixels
    displacement = tifffile.imread(malus.export(workspace.folder, "displacement", tmp_path / "d.tif"))
    assert png.shape == floats.shape == (*displacement.shape, 3)
    np.testing.assert_array_equal(words / 65535 * 2 - 1, png)
    np.testing.assert_allclose(png, floats, atol=2e-5)
    np.testing.assert_allclose(np.linalg.norm(floats, axis=-1), 1, atol=1e-5)
    pixel = exports.Exporter(workspace).dem().pixel
    down, right = np.gradient(displacement.astype(float), pixel)
    inner = (slice(20, -20), slice(20, -20))
    # Green is up: where the surface rises upwards, the normal leans down.
    for expected, channel in ((-right, 0), (down, 1)):
        slope = floats[..., channel][inner] / floats[..., 2][inner]
        assert np.corrcoef(slope.ravel(), expected[inner].ravel())[0, 1] > 0.8


def test_exr_displacement_equals_the_tiff(workspace: malus.Workspace, tmp_path: Path) -> None:
    library = pytest.importorskip("OpenEXR")
    tiff = tifffile.imread(malus.export(workspace.folder, "displacement", tmp_path / "d.tif"))
    with library.File(str(malus.export(workspace.folder, "displacement", tmp_path / "d.exr"))) as file:
        np.testing.assert_array_equal(file.channels()["Y"].pixels, tiff)


@pytest.mark.parametrize("name", ["a.las", "a.laz"])
def test_las_reads_back(workspace: malus.Workspace, points: np.ndarray, tmp_path: Path, name: str) -> None:
    laspy = pytest.importorskip("laspy")
    pytest.importorskip("lazrs")
    cloud = laspy.read(malus.export(workspace.folder, "las", tmp_path / name))
    np.testing.assert_allclose(cloud.xyz, points.reshape(-1, 3), atol=1e-3 * workspace.quality["gsd"])
    np.testing.assert_allclose(cloud.sigma, workspace.raster("fused/sigma.tif").ravel(), rtol=1e-5)
    assert cloud.red.max() > 255
    np.testing.assert_array_equal(
        scans.read_scan(tmp_path / name, "mm").colors, exports.Exporter(workspace).cloud()[0].colors
    )
    # As the specification requires for point format 7: converters to COPC refuse files without this bit.
    assert cloud.header.global_encoding.wkt
    assert cloud.header.number_of_points_by_return[0] == cloud.header.point_count == len(cloud.xyz)
    # Read by LASzip: point format 7, laid out by its specification.
    laszip = pytest.importorskip("laszip")
    names = "x y z intensity returns flags kind user angle source time red green blue sigma nx ny nz".split()
    forms = "<i4 <i4 <i4 <u2 u1 u1 u1 u1 <i2 <u2 <f8 <u2 <u2 <u2 <f4 <f4 <f4 <f4".split()
    records = np.zeros(points.shape[0] * points.shape[1], list(zip(names, forms, strict=True)))
    with (tmp_path / name).open("rb") as file:
        reader = laszip.LasUnZipper(file)
        header = reader.header
        reader.decompress_into(records.view(np.uint8))
        scale, offset = (
            np.array([getattr(header, f"{axis}_{word}") for axis in "xyz"]) for word in ("scale_factor", "offset")
        )
        reader.close()
    read = np.stack([records[axis] for axis in "xyz"], -1) * scale + offset
    np.testing.assert_allclose(read, points.reshape(-1, 3), atol=1e-3 * workspace.quality["gsd"])
    assert (records["returns"] == 0x11).all()  # the first of one
    np.testing.assert_array_equal(records["sigma"], cloud.sigma)
    np.testing.assert_array_equal(records["green"], cloud.green)


def test_points_at_the_rim_have_their_own_deviation(workspace: malus.Workspace) -> None:
    """Each point at the right or lower rim of a masked object had none."""
    exporter = exports.Exporter(workspace)
    surface = exporter.surface
    v, u = np.indices(surface.depth.shape)
    outside = np.hypot(u - 100, v - 80) > 60
    depth, sigma = (np.where(outside, np.float32(np.nan), values) for values in (surface.depth, surface.sigma))
    exporter.surface = malus.fusion.FusedSurface(depth, surface.normals, sigma, surface.camera)
    cloud, deviations = exporter.cloud()
    column, row = np.rint(exporter.pixels(cloud.vertices)).astype(int).T
    np.testing.assert_allclose(deviations, sigma[row, column], rtol=1e-6)


def test_e57_reads_back_in_meters(workspace: malus.Workspace, points: np.ndarray, tmp_path: Path) -> None:
    library = pytest.importorskip("pye57")
    file = library.E57(str(malus.export(workspace.folder, "e57", tmp_path / "a.e57")))
    scan = file.read_scan(0, colors=True, ignore_missing_fields=True)
    file.close()
    xyz = np.stack([scan[f"cartesian{axis}"] for axis in "XYZ"], -1) * 1000
    np.testing.assert_allclose(xyz, points.reshape(-1, 3), atol=1e-6)
    # By a reader that shares no code with the writer.
    other = pytest.importorskip("e57").read_points(str(tmp_path / "a.e57"))
    np.testing.assert_allclose(np.asarray(other.points) * 1000, points.reshape(-1, 3), atol=1e-4)
    mesh, _ = exports.Exporter(workspace).cloud()
    np.testing.assert_array_equal(
        np.stack([scan[f"color{name}"] for name in ("Red", "Green", "Blue")], -1), mesh.colors
    )
    np.testing.assert_array_equal(np.rint(np.asarray(other.color) * 255), mesh.colors)
    _, normals, colors = scans.read_scan(tmp_path / "a.e57", "mm")
    assert normals is not None
    np.testing.assert_array_equal(colors, mesh.colors)
    np.testing.assert_allclose(normals, mesh.normals, atol=1e-6)


def test_xyz_reads_back(workspace: malus.Workspace, points: np.ndarray, tmp_path: Path) -> None:
    path = malus.export(workspace.folder, "xyz", tmp_path / "a.xyz")
    mesh, sigma = exports.Exporter(workspace).cloud()
    table, finest = np.loadtxt(path), 1e-3 * workspace.quality["gsd"]
    np.testing.assert_allclose(table[:, :3], points.reshape(-1, 3), atol=finest)
    np.testing.assert_array_equal(table[:, 3:6], mesh.colors)
    np.testing.assert_allclose(table[:, 6:9], mesh.normals, atol=1e-5)
    np.testing.assert_allclose(table[:, 9], sigma, atol=finest)
    lines = path.read_text(encoding="utf-8").splitlines()
    assert {f"# {line}" for line in of_the_surface(workspace)} <= set(lines)
    read, normals = _core.read_oriented_points(str(path))  # as a prior or a reference
    np.testing.assert_array_equal(read, table[:, :3])
    np.testing.assert_allclose(normals, mesh.normals, atol=1e-4)


def test_e57_states_nothing_that_was_not_measured(workspace: malus.Workspace, tmp_path: Path) -> None:
    """It stated an air pressure of 0, which the standard forbids, and times in 1980."""
    reader = pytest.importorskip("e57")
    text = reader.raw_xml(str(malus.export(workspace.folder, "e57", tmp_path / "a.e57")))
    assert "<cartesianBounds" in text
    for element in ("atmosphericPressure", "temperature", "relativeHumidity", "dateTimeValue"):
        assert element not in text


def test_e57_far_from_the_origin_has_a_pose(
    workspace: malus.Workspace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a national grid its points had steps of half a meter."""
    library = pytest.importorskip("pye57")
    (mesh, sigma), far = exports.Exporter(workspace).cloud(), np.array([5e8, 5.4e9, 3e5])
    monkeypatch.setattr(exports.Exporter, "cloud", lambda _: (replace(mesh, vertices=mesh.vertices + far), sigma))
    path = malus.export(workspace.folder, "e57", tmp_path / "a.e57")
    file = library.E57(str(path))
    scan, stored = (file.read_scan(0, ignore_missing_fields=True, transform=transform) for transform in (True, False))
    header = file.get_header(0)
    bounds = [[getattr(header, f"{axis}{end}imum") for axis in "xyz"] for end in ("Min", "Max")]
    file.close()
    # The standard states the bounds in the frame of the stored points; those of the world were half a country beside them.
    local = np.stack([stored[f"cartesian{axis}"] for axis in "XYZ"], -1)
    np.testing.assert_allclose(bounds, [local.min(0), local.max(0)], atol=1e-6)
    xyz = np.stack([scan[f"cartesian{axis}"] for axis in "XYZ"], -1) * 1000 - far
    np.testing.assert_allclose(xyz, mesh.vertices, atol=1e-3 * workspace.quality["gsd"])
    # As a prior it lies where it was.
    read = scans.read_scan(path, "mm").points
    np.testing.assert_allclose(read - far, mesh.vertices, atol=1e-3 * workspace.quality["gsd"])


def test_stl_has_every_triangle_with_outward_normals(
    workspace: malus.Workspace, points: np.ndarray, tmp_path: Path
) -> None:
    mesh, _ = load_scene(malus.export(workspace.folder, "stl", tmp_path / "a.stl"))
    np.testing.assert_allclose(mesh.bounds, [points.min((0, 1)), points.max((0, 1))], atol=1e-3)
    assert len(mesh.faces) == len(exports.Exporter(workspace).mesh().triangles)
    assert (mesh.face_normals @ workspace.pose[0][2] < 0).mean() > 0.999


def test_meshes_far_from_the_origin_keep_their_form(
    workspace: malus.Workspace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In millimeters of a national grid an OBJ had steps of 10 mm, and an STL of 500 mm."""
    mesh, far = exports.Exporter(workspace).mesh(), np.array([5e8, 5.4e9, 3e5])
    monkeypatch.setattr(exports.Exporter, "mesh", lambda _: replace(mesh, vertices=mesh.vertices + far))
    lines = malus.export(workspace.folder, "obj", tmp_path / "a.obj").read_text().splitlines()
    read = np.array([line.split()[1:] for line in lines if line.startswith("v ")], float)
    np.testing.assert_allclose(read - far, mesh.vertices, atol=1e-3 * workspace.quality["gsd"])
    with pytest.raises(malus.DataError, match="reach [0-9]{10} mm, which STL rounds by"):
        malus.export(workspace.folder, "stl", tmp_path / "a.stl")
    assert not (tmp_path / "a.stl").exists()


def test_glb_describes_its_object_and_can_have_y_up(workspace: malus.Workspace, tmp_path: Path) -> None:
    plain, scene = load_scene(malus.export(workspace.folder, "glb", tmp_path / "plain.glb"))
    _, turned = load_scene(malus.export(workspace.folder, "glb", tmp_path / "up.glb", y_up=True))
    x, y, z = np.asarray(scene.bounds).T
    np.testing.assert_allclose(turned.bounds, np.array([x, z, -y[::-1]]).T, atol=1e-6)
    content = (tmp_path / "plain.glb").read_bytes()
    document = json.loads(content[20 : 20 + int.from_bytes(content[12:16], "little")])
    assert document["asset"]["extras"]["object"]["title"] == "Relief & label"
    assert document["asset"]["extras"]["gsd"] == workspace.quality["gsd"]
    assert f"detail: {document['asset']['extras']['detail']}" in of_the_surface(workspace)
    assert len(plain.faces) > 10000


def test_a_model_that_is_not_turned_yet_has_no_final_name(
    workspace: malus.Workspace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(_: Path) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(exports.meshes, "_turn_y_up", interrupted)
    with pytest.raises(KeyboardInterrupt):
        malus.export(workspace.folder, "glb", tmp_path / "up.glb", y_up=True)
    assert not list(tmp_path.iterdir())


def test_orthophoto_lies_on_the_elevation_model(workspace: malus.Workspace, tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    path = malus.export(workspace.folder, "orthophoto", tmp_path / "a.png")
    dem = exports.Exporter(workspace).dem()
    with rasterio.open(path) as file:
        picture, transform = file.read(), file.transform
    with rasterio.open(workspace.path("fused/dem.tif")) as file:
        assert transform.almost_equals(file.transform, precision=1e-6)
    known = np.isfinite(dem.elevation)
    np.testing.assert_array_equal(picture[3] > 0, known)
    seen = exports.Exporter(workspace).pixels(dem.points()[known])
    expected = sample(exports.Exporter(workspace).picture(), seen)
    assert np.abs(picture[:3, known].T - expected).max() <= 0.5 + 1e-9


def test_rims_have_the_color_of_the_object(workspace: malus.Workspace, tmp_path: Path) -> None:
    """In orthophotos, and at vertices of simplified meshes, they were mixed with the black of the pixels beside the object."""
    from PIL import Image

    exporter = exports.Exporter(workspace)
    surface = exporter.surface
    v, u = np.indices(surface.depth.shape)
    outside = np.hypot(u - 100, v - 80) > 60
    depth = np.where(outside, np.float32(np.nan), surface.depth)
    exporter.surface = malus.fusion.FusedSurface(depth, surface.normals, surface.sigma, surface.camera)
    exporter.__dict__["color"] = np.where(outside, np.float32(np.nan), np.float32(0.4))
    assert set(np.unique(exporter.picture())) == {0, 255}
    assert set(np.unique(exporter.texture())) == {255}, "viewers mix pixels beside it into the rim of a small object"
    exports.FORMATS["orthophoto"][0](exporter, tmp_path / "a.png")
    picture = np.asarray(Image.open(tmp_path / "a.png"))
    shown = picture[..., 3] > 0
    assert shown.sum() > 5000 and (picture[shown, :3] == 255).all()


def of_the_surface(workspace: malus.Workspace) -> list[str]:
    """The lines about the surface that every exported file must contain."""
    confidence = workspace.quality["confidence"]
    return [
        "unit: mm",
        f"confidence: {confidence['level']}",
        f"reasons: {' '.join(confidence['reasons'])}",
        "detail: detail from polarization everywhere, which nothing proves",
    ]


def test_share_of_the_prior_in_the_surface_is_stated(workspace: malus.Workspace) -> None:
    part = "on 40 % of the object, elsewhere the prior's"
    # The refinement's share is one of the pixels with usable polarization.
    for refined, usable, words in ((0.99, 1, "on nearly all"), (0.4, 1, part), (0.8, 0.5, part), (0.01, 1, "the surface is the prior's")):  # fmt: skip
        known = {"refinement": {"trusted_share": refined}, "polarization": {"valid_fraction": usable}}
        assert words in said_of({**workspace.quality, **known})["detail"]
    # A map of the surroundings leaves out what mirrors the object itself.
    mirroring = {"trusted_share": 0.8, "surroundings": {"self_mirroring_share": 0.5}}
    assert part in said_of({**workspace.quality, "refinement": mirroring, "polarization": None})["detail"]


def test_meshes_of_a_run_say_how_far_to_trust_them(finished_grid: Path) -> None:
    # Other programs usually open the run's own files, not an export.
    workspace = malus.Workspace(finished_grid)
    header = (finished_grid / "fused/surface.ply").read_bytes().split(b"end_header", 1)[0].decode()
    comments = {line.removeprefix("comment ") for line in header.splitlines() if line.startswith("comment ")}
    assert set(of_the_surface(workspace)) <= comments
    assert comments == {f"{key}: {value}" for key, value in said_of(workspace.quality).items()}
    glb = (finished_grid / "fused/surface.glb").read_bytes()
    extras = json.loads(glb[20 : 20 + int.from_bytes(glb[12:16], "little")])["asset"]["extras"]
    assert extras["confidence"] == workspace.quality["confidence"]
    assert (extras["unit_of_the_station"], extras["versions"]) == ("mm", workspace.manifest["versions"])


def test_drawings_and_maps_of_floats_say_how_far_to_trust_them(workspace: malus.Workspace, tmp_path: Path) -> None:
    from xml.etree import ElementTree

    told = {"title: Relief & label", "identifier: X 1907.4", *of_the_surface(workspace)}
    svg = ElementTree.parse(malus.export(workspace.folder, "contours", tmp_path / "a.svg")).getroot()
    assert told <= set(svg.findtext("{http://www.w3.org/2000/svg}desc", "").splitlines())
    ezdxf = pytest.importorskip("ezdxf")
    properties = ezdxf.readfile(malus.export(workspace.folder, "contours", tmp_path / "a.dxf")).header.custom_vars
    assert told <= {f"{name}: {value}" for name, value in properties}
    library = pytest.importorskip("OpenEXR")
    for name in ("normal-map", "displacement"):
        with library.File(str(malus.export(workspace.folder, name, tmp_path / f"{name}.exr"))) as file:
            assert told <= {f"{key}: {value}" for key, value in file.header().items()}


def test_e57_and_rti_say_how_far_to_trust_them(workspace: malus.Workspace, tmp_path: Path) -> None:
    from xml.etree import ElementTree

    told = {"title: Relief & label", "identifier: X 1907.4", *of_the_surface(workspace)}
    malus.export(workspace.folder, "rti", tmp_path / "a.ptm")
    assert told <= set((tmp_path / "a.ptm.txt").read_text().splitlines())
    info = json.loads((malus.export(workspace.folder, "relight", tmp_path / "relight") / "info.json").read_text())
    assert told <= {f"{key}: {value}" for key, value in info["about"].items()}
    reader = pytest.importorskip("e57")
    root = ElementTree.fromstring(reader.raw_xml(str(malus.export(workspace.folder, "e57", tmp_path / "a.e57"))))
    elements = {element.tag: element.text for element in root.iter()}
    said = {f"{tag.split('}')[1]}: {text}" for tag, text in elements.items() if tag.startswith("{urn:malus:surface/}")}
    assert (told - {"unit: mm"}) | {"unit: m"} <= said  # E57 is in meters
    assert (
        f"confidence {workspace.quality['confidence']['level']}"
        in elements["{http://www.astm.org/COMMIT/E57/2010-e57-v1.0}name"]
    )


def test_stl_says_its_unit_and_how_far_to_trust_it(workspace: malus.Workspace, tmp_path: Path) -> None:
    head = malus.export(workspace.folder, "stl", tmp_path / "a.stl").read_bytes()[:80].decode()
    assert head.startswith(
        f"Malus, mm, confidence {workspace.quality['confidence']['level']}, detail from polarization"
    )


def test_meshes_and_clouds_name_object_and_license(
    workspace: malus.Workspace, points: np.ndarray, tmp_path: Path
) -> None:
    told = ["identifier: X 1907.4", "title: Relief & label", "license: CC-BY-4.0", *of_the_surface(workspace)]
    ply = malus.export(workspace.folder, "ply", tmp_path / "a.ply")
    head = ply.read_bytes().split(b"end_header")[0].decode().splitlines()
    assert head[1].startswith("format") and all(f"comment {line}" in head for line in told)
    mesh, _ = load_scene(ply)
    assert len(mesh.faces) == len(exports.Exporter(workspace).mesh().triangles)
    np.testing.assert_allclose(mesh.bounds, [points.min((0, 1)), points.max((0, 1))], atol=1e-4)
    obj = malus.export(workspace.folder, "obj", tmp_path / "a.obj").read_text(encoding="utf-8").splitlines()
    assert all(f"# {line}" in obj for line in told)
    laspy = pytest.importorskip("laspy")
    with laspy.open(malus.export(workspace.folder, "las", tmp_path / "a.las")) as file:
        (record,) = [vlr for vlr in file.header.vlrs if vlr.user_id == "LASF_Spec" and vlr.record_id == 3]
    assert set(told) <= set(record.record_data.decode().splitlines())
    assert record.record_data.endswith(b"\0")


def test_images_name_object_and_license(workspace: malus.Workspace, tmp_path: Path) -> None:
    from xml.etree import ElementTree

    from PIL import Image

    packets = []
    pictures = {
        "orthophoto": malus.export(workspace.folder, "orthophoto", tmp_path / "a.png"),
        "colmap": malus.export(workspace.folder, "colmap", tmp_path / "dense") / "images/station.png",
        "normal map": malus.export(workspace.folder, "normal-map", tmp_path / "n.png"),
    }
    for name, path in pictures.items():
        with Image.open(path) as image:
            image.load()  # which checks every chunk
            packets.append(image.info["XML:com.adobe.xmp"])
            # A normal map holds no colors: it must have no color profile.
            assert (image.info.get("icc_profile", b"")[36:40] == b"acsp") == (name != "normal map")
    for name in ("dem", "displacement", "normal-map"):
        path = malus.export(workspace.folder, name, tmp_path / f"{name}.tif")
        with tifffile.TiffFile(path) as file:
            assert len(file.pages) == 1
            packets.append(file.pages[0].tags[700].value.decode())
    plain = tifffile.imread(workspace.path("fused/dem.tif"))
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "dem.tif"), plain)
    dc = "{http://purl.org/dc/elements/1.1/}"
    for packet in packets:
        root = ElementTree.fromstring(packet.split("?>", 1)[1].rsplit("<?", 1)[0])
        assert "".join(next(root.iter(f"{dc}title")).itertext()).strip() == "Relief & label"
        assert next(root.iter(f"{dc}identifier")).text == "X 1907.4"
        surface = {element.tag.rsplit("}")[-1]: element.text for element in root.iter() if element.tag.startswith(f"{{{NAMESPACE}}}")}  # fmt: skip
        assert set(of_the_surface(workspace)) <= {f"{key}: {value}" for key, value in surface.items()}
        terms = next(root.iter("{http://ns.adobe.com/xap/1.0/rights/}UsageTerms"))
        assert "".join(terms.itertext()).strip() == "CC-BY-4.0"


def test_xmp_has_every_entry_of_the_catalog() -> None:
    """Material and date of the recording were missing in PNG and TIFF files."""
    from xml.etree import ElementTree

    keys = [field.strip("`") for row in catalog_rows() for field in row.split("|")[1].replace(",", " ").split()]
    assert len(keys) == 12
    packed = xmp.packet("stone", {key: f"the {key} & more" for key in keys}, {"unit": "mm"})
    root = ElementTree.fromstring(packed.split("?>", 1)[1].rsplit("<?", 1)[0])
    texts = {text.strip() for text in root.itertext()}
    assert {f"the {key} & more" for key in keys} <= texts


def catalog_rows() -> list[str]:
    """The rows of the table of [object] in docs/station-file.md."""
    text = (ROOT / "docs" / "station-file.md").read_text(encoding="utf-8")
    return re.findall(r"^\| `.*$", text.split("## [object]")[1].split("\n## ")[0], re.MULTILINE)


def test_the_color_profile_does_not_depend_on_the_time() -> None:
    """PNG and JPEG files of two equal exports differed by the date in their profile."""
    import io

    from PIL import ImageCms

    profile = srgb_profile()
    assert struct.unpack(">6H", profile[24:36]) == (2000, 1, 1, 0, 0, 0)
    assert "sRGB" in ImageCms.getProfileDescription(ImageCms.ImageCmsProfile(io.BytesIO(profile)))


def dxf_lines_of_gdal(path: Path) -> list[np.ndarray]:
    """Lines of a drawing (N×3, flat ones N×2) as GDAL reads them."""
    pyogrio = pytest.importorskip("pyogrio")
    lines = []
    for geometry in pyogrio.raw.read(path)[2]:
        order, kind, count = struct.unpack_from("<BII", geometry)
        assert order == 1 and kind in (2, 1002, 0x80000002)  # lines in the plane, and the two codes of lines in space
        sides = 2 if kind == 2 else 3
        lines.append(np.frombuffer(geometry, "<f8", sides * count, 9).reshape(-1, sides))
    return lines


@pytest.mark.parametrize("ending", ["svg", "dxf"])
def test_contours_lie_at_their_height(workspace: malus.Workspace, tmp_path: Path, ending: str) -> None:
    dem = exports.Exporter(workspace).dem()
    path = malus.export(workspace.folder, "contours", tmp_path / f"a.{ending}", interval=0.5)
    if ending == "dxf":
        ezdxf = pytest.importorskip("ezdxf")
        document = ezdxf.readfile(path)
        assert document.header["$INSUNITS"] == 4  # mm
        assert document.header["$MEASUREMENT"] == 1  # metric
        lines = [np.array(list(p.points())) for p in document.modelspace().query("POLYLINE")]
        every = np.concatenate(lines)
        assert np.allclose(every[:, 2] % 0.5, 0, atol=1e-9) or np.allclose(every[:, 2] % 0.5, 0.5, atol=1e-9)
        rows, columns = -every[:, 1] / dem.pixel, every[:, 0] / dem.pixel
        assert rows.min() > -1e-9 and columns.max() < dem.elevation.shape[1] - 1 + 1e-9
        height = sample(dem.elevation[..., None].astype(float), np.stack([columns, rows], -1))[:, 0]
        known = np.isfinite(height)
        assert known.mean() > 0.8
        np.testing.assert_allclose(height[known], every[known, 2], atol=0.05)
        read = dxf_lines_of_gdal(path)
        assert len(read) == len(lines)
        np.testing.assert_allclose(np.concatenate(read), every, atol=1e-9)
    else:
        from xml.etree import ElementTree

        root = ElementTree.parse(path).getroot()
        assert root.attrib["width"].endswith("mm")
        width = float(root.attrib["width"][:-2])
        assert width == pytest.approx(dem.elevation.shape[1] * dem.pixel * 1.1, rel=0.1)
        assert len(root.findall(".//{http://www.w3.org/2000/svg}path")) > 5
        # Drawn at 25.4 px an inch, a pixel is a millimeter.
        svgelements = pytest.importorskip("svgelements")
        drawn = list(svgelements.SVG.parse(path, ppi=25.4).select(lambda part: isinstance(part, svgelements.Path)))
        expected = [line for layer in drawings.contours(dem, 0.5) for line in layer.lines]
        assert len(drawn) == len(expected)
        for curve, line in zip(drawn, expected, strict=True):
            seen = np.array([(segment.end.x, -segment.end.y) for segment in curve])
            np.testing.assert_allclose(seen - seen[0], line[:, :2] - line[0, :2], atol=2e-3)


@pytest.mark.parametrize("interval", [0.5, None])
def test_contours_go_up_to_the_top(interval: float | None) -> None:
    """A boss on less than a thousandth of the surface had none: the lines ended at the height of what is around it."""
    elevation = np.tile(np.linspace(0, 1, 100, dtype=np.float32), (100, 1))
    elevation[50:53, 50:53] = 3.2
    dem = malus.surface.Dem(elevation, 0.1, np.zeros(3), *np.eye(3))
    heights = [float(layer.name) for layer in drawings.contours(dem, interval) if layer.lines]
    assert max(heights) > 2.9 and min(heights) < 0.6
    with pytest.raises(malus.InputError, match="inf, expected a positive length"):
        drawings.contours(dem, float("inf"))
    # A point that is wrong by far neither makes a thousand lines nor takes those of the relief.
    elevation[80, 80] = 1e5
    assert 8 < sum(len(layer.lines) > 0 for layer in drawings.contours(dem)) < 26


def test_sections_equal_the_profiles(workspace: malus.Workspace, tmp_path: Path) -> None:
    ezdxf = pytest.importorskip("ezdxf")
    path = malus.export(workspace.folder, "sections", tmp_path / "a.dxf")
    document = ezdxf.readfile(path)
    lines = {line.dxf.layer: np.array(list(line.get_points("xy"))) for line in document.modelspace()}
    assert set(lines) == {"1 prior", "1 fused"}
    profile = workspace.quality["profiles"][0]
    fused = lines["1 fused"]
    np.testing.assert_allclose(fused[:, 0], profile["position"], atol=1e-6)
    np.testing.assert_allclose(np.diff(fused[:, 1]), np.diff(np.array(profile["fused"], float)), atol=1e-6)
    for read, line in zip(dxf_lines_of_gdal(path), lines.values(), strict=True):
        np.testing.assert_allclose(read[:, :2], line, atol=1e-9)


@pytest.mark.parametrize("profiles", [("beside", "1", "beside"), ("1", "beside")])
def test_a_profile_beside_the_surface_has_no_section(
    workspace: malus.Workspace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, profiles: tuple[str, ...]
) -> None:
    """It ended the export, or moved the prior's line away from the fused one of another profile."""
    ezdxf = pytest.importorskip("ezdxf")
    quality = json.loads(json.dumps(workspace.quality))
    (known,) = quality["profiles"]
    beside = {**known, "name": "2", "position": [], "prior": [], "fused": []}
    quality["profiles"] = [known if name == "1" else beside for name in profiles]
    monkeypatch.setattr(malus.Workspace, "quality", quality)
    path = malus.export(workspace.folder, "sections", tmp_path / "a.dxf")
    lines = {line.dxf.layer: np.array(list(line.get_points("xy"))) for line in ezdxf.readfile(path).modelspace()}
    assert set(lines) == {"1 prior", "1 fused"}
    apart = lines["1 prior"][:, 1] - lines["1 fused"][:, 1]
    np.testing.assert_allclose(apart, np.array(known["prior"], float) - np.array(known["fused"], float), atol=1e-6)
    quality["profiles"] = [beside]
    with pytest.raises(malus.DataError, match="nothing to draw"):
        malus.export(workspace.folder, "sections", tmp_path / "b.dxf")
    assert not (tmp_path / "b.dxf").exists()


def test_colmap_can_continue_with_the_surface(workspace: malus.Workspace, points: np.ndarray, tmp_path: Path) -> None:
    program = shutil.which("colmap")
    if program is None:
        pytest.skip("COLMAP is not installed (apt install colmap)")
    folder = malus.export(workspace.folder, "colmap", tmp_path / "dense")
    outcome = run_program(
        program, "stereo_fusion", "--workspace_path", folder, "--input_type", "geometric",
        "--output_path", tmp_path / "fused.ply", "--StereoFusion.min_num_pixels", "1",
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
    mesh, _ = load_scene(tmp_path / "fused.ply")
    assert len(mesh.vertices) > 0.99 * points.shape[0] * points.shape[1]
    # COLMAP's fusion uses the ray of a pixel's corner instead of its center, which shifts the points by half a pixel.
    camera, (rotation, translation) = workspace.camera, workspace.pose
    x, y, z = (np.asarray(mesh.vertices) @ rotation.T + translation).T
    pixels = np.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], -1) + 0.5
    np.testing.assert_allclose(pixels, np.rint(pixels), atol=1e-2)
    depth = sample(workspace.raster("fused/depth.tif")[..., None], np.rint(pixels))[:, 0]
    np.testing.assert_allclose(z, depth, atol=1e-3)
    with pytest.raises(malus.InputError, match="is there already"):
        malus.export(workspace.folder, "colmap", folder)


def test_relight_folder_shades_as_openlime_computes_it(workspace: malus.Workspace, tmp_path: Path) -> None:
    from PIL import Image

    from malus.rti import relightable

    folder = malus.export(workspace.folder, "relight", tmp_path / "relight")
    info = json.loads((folder / "info.json").read_text())
    assert (info["type"], info["colorspace"], info["nplanes"]) == ("ptm", "lrgb", 9)
    assert info["pixelSizeInMM"] == pytest.approx(workspace.quality["gsd"])
    planes = [np.asarray(Image.open(folder / f"plane_{k}.jpg")) / 255 for k in range(3)]
    scale, bias = (np.reshape(info["materials"][0][name], (3, 3)) for name in ("scale", "bias"))
    # As in OpenLIME's ShaderRTI.js for PTM and LRGB: weights of light directions times dequantized coefficients.
    u, v = -0.5, 0.4
    weights = np.reshape([1, u, v, u * u, u * v, v * v], (2, 3))
    light = sum(((planes[k] - bias[k]) * scale[k] * weights[k - 1]).sum(-1) for k in (1, 2))
    direction = np.array([u, v, np.sqrt(1 - u * u - v * v)])
    known = relightable(workspace)
    cosine = np.maximum(known.normals @ direction, 0)
    assert np.nanmean(np.abs(light - cosine)) < 0.05
    normals = sixteen_bits(folder / "normals.png") / 65535 * 2 - 1
    assert np.nanmax(np.abs(normals - known.normals)) < 2e-5
    with Image.open(folder / "normals.png") as picture:
        assert "icc_profile" not in picture.info, "normals are no colors"
    np.testing.assert_array_equal(np.asarray(Image.open(folder / "unshaded.png")), known.colors)
    assert np.abs((planes[0] - bias[0]) * scale[0] * 255 - known.colors).mean() < 2
    with pytest.raises(malus.InputError, match="is there already"):
        malus.export(workspace.folder, "relight", folder)


def test_relight_normals_outside_of_the_object_face_the_viewer(
    workspace: malus.Workspace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """There they had length 0, which a shader cannot normalize."""
    found = rti.relightable(workspace)
    found.normals[:10] = np.nan
    monkeypatch.setattr(rti, "relightable", lambda _: found)
    folder = malus.export(workspace.folder, "relight", tmp_path / "relight")
    levels = sixteen_bits(folder / "normals.png")
    np.testing.assert_array_equal(levels[:10], np.broadcast_to([32768, 32768, 65535], levels[:10].shape))


def read_ptm(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients and colors, read by the specification of PTM 1.2."""
    kind, form, width, height, scales, biases, rest = path.read_bytes().split(b"\n", 6)
    assert (kind, form) == (b"PTM_1.2", b"PTM_FORMAT_LRGB")
    shape = (int(height), int(width))
    count = shape[0] * shape[1]
    scale, bias = (np.array([float(x) for x in line.split()]) for line in (scales, biases))
    raw = np.frombuffer(rest, np.uint8)
    assert raw.size == 9 * count
    coefficients = (raw[: 6 * count].reshape(*shape, 6)[::-1] - bias) * scale
    return coefficients, raw[6 * count :].reshape(*shape, 3)[::-1]


def test_a_large_ptm_is_written_in_parts(tmp_path: Path) -> None:
    """Copies of all coefficients took three times their memory: 7 GB at 8192 x 6500 pixels."""
    random = np.random.default_rng(1)
    values = random.normal(size=(60, 500, 6))
    colors = random.integers(0, 256, (60, 500, 3), dtype=np.uint8)
    tracemalloc.start()
    try:
        write_ptm(tmp_path / "a.ptm", values, colors)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most < 0.5 * values.nbytes
    coefficients, read = read_ptm(tmp_path / "a.ptm")
    np.testing.assert_array_equal(read, colors)
    np.testing.assert_allclose(coefficients / 256, values, atol=2 * np.ptp(values) / 255)


def test_rti_shades_like_the_normals(workspace: malus.Workspace, tmp_path: Path) -> None:
    coefficients, colors = read_ptm(malus.export(workspace.folder, "rti", tmp_path / "a.ptm"))
    normals = workspace.raster("fused/normals.tif").astype(float) * (1, -1, -1)
    assert coefficients.shape[:2] == normals.shape[:2] and colors.max() > 200
    for light in ([0.0, 0.0, 1.0], [0.5, 0.0, np.sqrt(0.75)], [-0.3, 0.6, np.sqrt(0.55)]):
        u, v, _ = light
        shaded = coefficients @ [u * u, v * v, u * v, u, v, 1] / 256
        expected = np.maximum(normals @ light, 0)
        # For a frontal plane, a polynomial of second degree is 0.07 too bright in the middle: an error of the format itself.
        assert np.median(np.abs(shaded - expected)) < 0.08
        assert np.corrcoef(shaded.ravel(), expected.ravel())[0, 1] > 0.97


def test_what_a_killed_export_had_begun_is_removed_by_the_next(finished_grid: Path, tmp_path: Path) -> None:
    old, young, of_others = (tmp_path / f".{name}.partial-0a1b.tif" for name in ("a", "a.2", "b"))
    for path in (old, young, of_others):
        path.write_bytes(b"half")
    for path in (old, of_others):
        os.utime(path, (0, 0))
    malus.export(finished_grid, "dem", tmp_path / "a.tif")
    assert set(tmp_path.iterdir()) == {tmp_path / "a.tif", young, of_others}


def test_names_that_are_not_utf_8_are_refused(workspace: malus.Workspace, tmp_path: Path) -> None:
    """From Python the extension refused them as "incompatible function arguments", which is no error of Malus."""
    name = os.fsdecode(b"stone\xff")
    dem = malus.surface.Dem(np.zeros((2, 2), np.float32), 1.0, np.zeros(3), *np.eye(3))
    for call in (
        lambda: malus.export(workspace.folder, "ply", tmp_path / f"{name}.ply"),
        lambda: malus.surface.write_dem(tmp_path / f"{name}.tif", dem, unit="mm", name="stone"),
        lambda: malus.Workspace(tmp_path / name).quality,
    ):
        with pytest.raises(malus.InputError, match="this name is not in UTF-8"):
            call()
    assert not list(tmp_path.iterdir())


def test_dem_export_equals_that_of_the_run(finished_grid: Path, tmp_path: Path) -> None:
    path = malus.export(finished_grid, "dem", tmp_path / "a.tif")
    rasterio = pytest.importorskip("rasterio")
    with rasterio.open(path) as exported, rasterio.open(finished_grid / "fused/dem.tif") as made:
        np.testing.assert_array_equal(exported.read(1), made.read(1))
        assert (exported.crs, exported.transform, exported.tags()) == (made.crs, made.transform, made.tags())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--format", "dwg"], "invalid choice"),
        (["--format", "las", "--faces", "10"], "--faces is for"),
        (["--format", "obj", "--faces", "2"], "at least 4"),
        (["--format", "stl", "--interval", "1"], "--interval is for contours"),
        (["--format", "stl", "--interval", "0"], "--interval is for contours"),
        (["--format", "obj", "--y-up"], "--y-up is for glb"),
        (["--format", "contours", "--interval", "-1"], "expected a positive length"),
        (["--format", "contours", "--interval", "0.0001"], "expected at most 1000"),
        (["--format", "displacement", "-o", "d.png"], "expected .tif"),
        ([], "--format"),
    ],
)
def test_wrong_requests_are_explained(finished_grid: Path, arguments: list[str], message: str) -> None:
    outcome = run_malus("export", finished_grid, *arguments)
    assert outcome.code == 2
    assert message in outcome.err and "Traceback" not in outcome.err


def test_missing_package_is_named(finished_grid: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "laspy", None)
    with pytest.raises(malus.ExternalError, match=r"laspy.*malus\[export\]"):
        malus.export(finished_grid, "las", tmp_path / "a.las")
    assert not list(tmp_path.iterdir())


def test_failed_export_leaves_nothing(finished_grid: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(malus.InputError, match="cannot be written"):
        malus.export(finished_grid, "e57", tmp_path / "file" / "a.e57")
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_exports_of_an_earlier_surface_are_reported(
    finished_grid: Path, small_station_source: Path, tmp_path: Path
) -> None:
    """Such exports belong to the user and stay. Exports outside of the workspace and removed ones are not reported."""
    work = tmp_path / "work"
    shutil.copytree(finished_grid, work)
    named = work / "export/named.glb"
    for name, output in (("stl", None), ("obj", None), ("contours", None), ("ply", tmp_path / "a.ply"), ("glb", named)):
        malus.export(work, name, output)
    (work / "export/contours.svg").unlink()
    run = ("assess", small_station_source / "station.toml", "-o", work, "--fusion", "grid", "--quiet")
    kept = malus_here(*run)
    assert kept.code == 0 and "export" not in kept.err
    changed = malus_here(*run, "--set", "prior.smoothing_px=4")
    told = [line for line in changed.err.splitlines() if "is of an earlier result" in line]
    assert changed.code == 0 and len(told) == 3, changed.err
    assert all(any(f"export/{name}" in line for line in told) for name in ("surface.obj", "surface.stl", "named.glb"))
    assert (work / "export/surface.stl").exists()
    alone = malus_station(*run[1:], "--set", "prior.smoothing_px=4")
    assert alone.code == 0 and [line for line in alone.err.splitlines() if "is of an earlier result" in line] == told
    malus.export(work, "obj")
    again = malus_here(*run, "--set", "prior.smoothing_px=4").err
    assert "surface.stl is of an earlier" in again and "surface.obj" not in again
    # A record that a full disk or another program spoiled must not end runs.
    for spoiled in (b"", b"[1", b"[1]", b'{"a": 1}'):
        (work / "export/made_from.json").write_bytes(spoiled)
        assert _core.overtaken_exports(str(work)) == [], spoiled


def test_exports_that_end_at_once_are_all_recorded(
    finished_grid: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    work, names = tmp_path / "work", {"a.stl", "b.ply", "c.obj"}
    shutil.copytree(finished_grid, work)
    (work / "export").mkdir(exist_ok=True)

    def slowly(path: Path) -> dict[str, Any] | None:
        found = read_record(path)
        time.sleep(0.2)
        return found

    monkeypatch.setattr(exported, "read_record", slowly)
    threads = [
        threading.Thread(target=exported.note, args=(malus.Workspace(work), work / "export" / name)) for name in names
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert set(read_record(work / "export/made_from.json") or {}) == names


def test_an_export_is_discarded_if_a_run_changes_the_surface_meanwhile(
    finished_grid: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise it could have the depth of one surface and the normals of the next."""
    work = tmp_path / "work"
    shutil.copytree(finished_grid, work)

    def overtaken(*arguments: Any) -> None:
        write_ply(*arguments)
        _core.forget_step(str(work), "fuse")

    write_ply = _core.write_ply
    assert malus.export(work, "ply", tmp_path / "a.ply").exists()
    monkeypatch.setattr(_core, "write_ply", overtaken)
    with pytest.raises(malus.InputError, match="was changed by another run meanwhile"):
        malus.export(work, "ply", tmp_path / "b.ply")
    assert not (tmp_path / "b.ply").exists()


@pytest.mark.parametrize("format", ["obj", "orthophoto", "rti"])
def test_files_beside_an_export_that_a_run_overtakes_are_not_kept(
    finished_grid: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, format: str
) -> None:
    def changed(_: malus.Workspace) -> None:
        raise malus.InputError("was changed by another run meanwhile")

    path = tmp_path / f"a{exports.FORMATS[format][2][0]}"
    malus.export(finished_grid, format, path)
    assert len(list(tmp_path.iterdir())) == 1 + len(exports.BESIDE[format])
    monkeypatch.setattr(malus.Workspace, "require_unchanged", changed)
    with pytest.raises(malus.InputError, match="meanwhile"):
        malus.export(finished_grid, format, path)
    assert not list(tmp_path.iterdir())
