"""Integrations into other programs: Blender runs if it is installed, stand-ins take the place of Meshroom and Metashape."""

from __future__ import annotations

import importlib
import json
import os
import pkgutil
import runpy
import shlex
import shutil
import sys
import types
from pathlib import Path

import numpy as np
import pytest

import malus
from conftest import ROOT, cloud_in_meters, metashape_cameras, run_program
from conftest import malus as run_malus

_IN_BLENDER = """
import json, sys
import bpy
from bpy_extras.object_utils import world_to_camera_view
sys.path.insert(0, sys.argv[-2])
import blender_malus
blender_malus.register()
folder = sys.argv[-1]
assert bpy.ops.import_scene.malus(filepath=folder + "/manifest.json") == {"FINISHED"}
camera = bpy.context.scene.camera
mesh = next(thing for thing in bpy.data.objects if thing.type == "MESH" and "confidence" in thing)
layer = mesh.data.uv_layers.active.data
chosen = range(0, len(mesh.data.loops), max(1, len(mesh.data.loops) // 500))
points = [mesh.matrix_world @ mesh.data.vertices[mesh.data.loops[k].vertex_index].co for k in chosen]
print("FOUND" + json.dumps({
    "name": mesh.name, "gsd": mesh["gsd"], "confidence": mesh["confidence"], "title": mesh["object_title"],
    "vertices": len(mesh.data.vertices), "points": [list(point) for point in points],
    "uv": [list(layer[k].uv) for k in chosen],
    "seen": [list(world_to_camera_view(bpy.context.scene, camera, point))[:2] for point in points],
    "resolution": [bpy.context.scene.render.resolution_x, bpy.context.scene.render.resolution_y],
    "unit": bpy.context.scene.unit_settings.length_unit}))
try:
    bpy.ops.import_scene.malus(filepath=folder + "/fused/manifest.json")
except RuntimeError as error:
    assert "expected a folder that `malus run` has finished" in str(error)
else:
    raise SystemExit("nothing was refused")
blender_malus.unregister()
"""


def test_blender_imports_a_workspace(finished_grid: Path, tmp_path: Path) -> None:
    program = shutil.which("blender")
    if program is None:
        pytest.skip("Blender is not installed (apt install blender python3-numpy)")
    script = tmp_path / "script.py"
    script.write_text(_IN_BLENDER)
    outcome = run_program(
        program, "--background", "--factory-startup", "--python-exit-code", "1", "--python", script, "--",
        ROOT / "integrations", finished_grid,
    )  # fmt: skip
    assert outcome.code == 0, outcome.out + outcome.err
    found = json.loads(next(line for line in outcome.out.splitlines() if line.startswith("FOUND"))[5:])
    workspace = malus.Workspace(finished_grid)
    assert found["name"] == "small" and found["title"] == "Relief & label" and found["unit"] == "MILLIMETERS"
    assert found["gsd"] == workspace.quality["gsd"]
    assert found["resolution"] == [200, 160]
    # The camera sees every vertex where its texture was taken: lens, principal point and pose are those of the station.
    error = (np.array(found["seen"]) - np.array(found["uv"])) * [200, 160]
    assert np.abs(error).max() < 0.05
    # The vertices lie in the station's world frame, in meters.
    camera, (rotation, translation) = workspace.camera, workspace.pose
    x, y, z = (1000 * np.array(found["points"]) @ rotation.T + translation).T
    pixels = np.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], -1)
    expected = np.array(found["uv"]) * [200, 160] - 0.5
    expected[:, 1] = 160 - 1 - expected[:, 1]
    np.testing.assert_allclose(pixels, expected, atol=0.05)


_PIXELS_IN_BLENDER = """
import sys
import bpy, numpy
*paths, output = sys.argv[sys.argv.index("--") + 1:]
read = []
for path in paths:
    image = bpy.data.images.load(path)
    width, height = image.size
    pixels = numpy.empty(width * height * 4, numpy.float32)
    image.pixels.foreach_get(pixels)
    read.append(pixels.reshape(height, width, 4)[::-1, :, :3])
numpy.savez(output, *read)
"""


def test_blender_opens_displacement_and_normal_map(finished_grid: Path, tmp_path: Path) -> None:
    pytest.importorskip("OpenEXR")
    program = shutil.which("blender")
    if program is None:
        pytest.skip("Blender is not installed (apt install blender python3-numpy)")
    paths = [malus.export(finished_grid, name, tmp_path / f"{name}.exr") for name in ("displacement", "normal-map")]
    script = tmp_path / "script.py"
    script.write_text(_PIXELS_IN_BLENDER)
    outcome = run_program(
        program, "--background", "--factory-startup", "--python-exit-code", "1", "--python", script, "--",
        *paths, tmp_path / "read.npz",
    )  # fmt: skip
    assert outcome.code == 0, outcome.out + outcome.err
    displacement, normals = np.load(tmp_path / "read.npz").values()
    elevation = np.nan_to_num(malus.Workspace(finished_grid).raster("fused/dem.tif"))
    np.testing.assert_array_equal(displacement[..., 0], elevation)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1, atol=1e-5)
    # Blue points to the viewer.
    assert np.median(normals[..., 2]) > 0.8


@pytest.fixture
def meshroom(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stand-in for Meshroom, which is not installed: it keeps the descriptor's declarations unchanged."""
    desc = types.ModuleType("meshroom.core.desc")
    desc.CommandLineNode = object  # type: ignore[attr-defined]
    desc.File = desc.ChoiceParam = lambda **given: types.SimpleNamespace(**given)  # type: ignore[attr-defined]
    core = types.ModuleType("meshroom.core")
    core.desc = desc  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "meshroom", types.ModuleType("meshroom"))
    monkeypatch.setitem(sys.modules, "meshroom.core", core)


def test_meshroom_node_runs_in_a_folder_of_meshroom(
    tiny_station: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, meshroom: None
) -> None:
    # Load the node as Meshroom does: packages below a folder of MESHROOM_NODES_PATH, and the modules in them.
    nodes = tmp_path / "nodes"
    package = nodes / "malus_nodes"
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    shutil.copy(ROOT / "integrations/meshroom_malus.py", package)
    monkeypatch.syspath_prepend(str(nodes))
    assert [name for _, name, is_package in pkgutil.walk_packages([str(nodes)]) if is_package] == ["malus_nodes"]
    node = importlib.import_module("malus_nodes.meshroom_malus").MalusReconstruction
    values = {parameter.name: parameter.value for parameter in [*node.inputs, *node.outputs]}
    values |= {"station": str(tiny_station), "fusion": "grid"}
    # Meshroom's own files are in the node's folder before the program starts.
    cache = tmp_path / "a cache" / "MalusReconstruction" / "1234"
    cache.mkdir(parents=True)
    own = [cache / "status", cache / "log"]
    for file in own:
        file.write_text("Meshroom's")
    made = {name: str(value).replace("{nodeCacheFolder}", str(cache)) for name, value in values.items()}
    words = shlex.split(node.commandLine.format(**{f"{name}Value": value for name, value in made.items()}))
    assert words.pop(0) == "malus"
    outcome = run_malus(*words, cwd=cache)
    assert outcome.code == 0, outcome.err
    assert all(Path(made[output.name]).exists() for output in node.outputs)
    assert all(file.read_text() == "Meshroom's" for file in own)


class _Chunk:
    """The part of a Metashape chunk that the script uses, for a station with known camera and cloud, in meters."""

    def __init__(self, station: Path) -> None:
        self.point_cloud: object = "is there"
        self.transform = types.SimpleNamespace(scale=0.25)
        self.crs = types.SimpleNamespace(wkt='LOCAL_CS["Local Coordinates (m)"]')
        self._station = station

    def exportCameras(self, path: str, *, format: str) -> None:  # noqa: N802
        assert format == "XML"
        Path(path).write_text(metashape_cameras(self._station, "station"))

    def exportPointCloud(self, path: str, *, format: str, **_: object) -> None:  # noqa: N802
        assert format == "PLY"
        cloud_in_meters(self._station, Path(path))


def _run_in_metashape(chunk: _Chunk, folder: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Run the script in a stand-in for Metashape; returns the messages that it shows its user."""
    shown: list[str] = []
    metashape = types.ModuleType("Metashape")
    metashape.CamerasFormatXML, metashape.PointCloudFormatPLY, metashape.PointCloudData = "XML", "PLY", 1  # type: ignore[attr-defined]
    metashape.app = types.SimpleNamespace(  # type: ignore[attr-defined]
        document=types.SimpleNamespace(chunk=chunk),
        messageBox=shown.append,
        getExistingDirectory=lambda hint: str(folder),
        getString=lambda label, value: "station",
    )
    monkeypatch.setitem(sys.modules, "Metashape", metashape)
    monkeypatch.setenv("PATH", str(Path(sys.executable).parent), prepend=os.pathsep)
    runpy.run_path(str(ROOT / "integrations/metashape_malus.py"))
    return shown


def test_metashape_script_writes_a_station_that_runs(
    small_station: Path, small_station_source: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stand-in for Metashape, which is not installed, has a chunk with the station's camera and cloud."""
    chunk = _Chunk(small_station_source / "station.toml")
    expected = malus.Station.load(small_station).describe()["camera"]
    small_station.unlink()
    (shown,) = _run_in_metashape(chunk, small_station.parent / "pol", monkeypatch)
    assert small_station.exists(), shown
    description = malus.Station.load(small_station).describe()
    assert description["unit"] == "m"
    camera = description["camera"]
    np.testing.assert_allclose(camera["params"][:4], expected["params"], atol=1e-9)
    assert not any(camera["params"][4:]), "terms of a distortion that the lens has not"
    np.testing.assert_allclose(camera["rotation"], expected["rotation"], atol=1e-12)
    np.testing.assert_allclose(1000 * np.array(camera["translation"]), expected["translation"], atol=1e-9)
    outcome = run_malus("check", small_station, cwd=small_station.parent)
    assert outcome.code == 0, outcome.err
    # On a second run the station file exists already: the script shows the error of malus.
    (shown,) = _run_in_metashape(chunk, small_station.parent / "pol", monkeypatch)
    assert "exists already" in shown


@pytest.mark.parametrize("missing", ["point cloud", "scale", "Local Coordinates"])
def test_metashape_script_says_what_the_chunk_lacks(
    small_station: Path, monkeypatch: pytest.MonkeyPatch, missing: str
) -> None:
    chunk = _Chunk(small_station)
    if missing == "point cloud":
        chunk.point_cloud = None
    elif missing == "scale":
        chunk.transform.scale = None
    else:
        chunk.crs.wkt = 'GEOGCS["WGS 84"]'
    (shown,) = _run_in_metashape(chunk, small_station.parent / "pol", monkeypatch)
    assert missing in shown
    assert not (small_station.parent / "cameras.xml").exists()
