"""Results of malus.reconstruct, in memory and from a workspace; cameras and units of its inputs."""

from __future__ import annotations

import inspect
import pickle
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import malus
from conftest import QUICK
from malus import synthetic
from malus.glossary import definitions
from malus.object import Object
from malus.threads import ALL_CORES


@pytest.fixture(scope="module")
def result(scene: synthetic.Scene, sensor: synthetic.Sensor, images: list[np.ndarray]) -> malus.Result:
    station = malus.Station(
        images, sensor.angles_deg, scene.camera, prior_depth=scene.depth, name="in memory", frames_averaged=16
    )
    options = malus.Options(refine=QUICK)
    result = malus.reconstruct(station, options)
    options.surface.subsample = 3  # of the caller's next run
    return result


def test_result_describes_itself(result: malus.Result, scene: synthetic.Scene) -> None:
    camera = result.camera
    assert camera is not None and result.quality is not None and result.confidence is not None
    assert (camera.width, camera.height) == scene.depth.shape[::-1]
    np.testing.assert_allclose([camera.fx, camera.fy, camera.cx, camera.cy], scene.camera.params)
    np.testing.assert_allclose(result.pose[0], scene.camera.rotation)
    np.testing.assert_allclose(result.pose[1], scene.camera.translation)
    assert result.status == result.quality["status"]
    assert result.confidence.level == result.quality["confidence"]["level"]
    assert result.warnings == result.quality["warnings"]
    assert "'in memory'" in repr(result) and result.confidence.level in repr(result)
    assert len(repr(result)) < 200
    assert "converged" not in repr(result), "a solver's word says nothing of how good the surface is"
    assert "still changing when" in repr(replace(result, status="not converged"))
    assert "GSD 60 µm" in repr(replace(result, quality={**result.quality, "gsd": 6e-5, "unit": "m"}))


def test_notebook_shows_prior_and_surface(result: malus.Result) -> None:
    page = result._repr_html_()
    assert page.count("<img") == 2
    assert "in memory" in page and "data:image/png;base64," in page


def test_rasters_cannot_be_changed(result: malus.Result) -> None:
    with pytest.raises(ValueError, match="read-only"):
        result.depth[0, 0] = 1


def test_a_changed_pose_moves_no_camera(result: malus.Result) -> None:
    """A translation that was scaled to meters in place moved the result's camera, and every point computed with it later."""
    assert result.camera is not None and result.pose is not None
    before = result.camera.description()
    for rotation, translation in (result.pose, result.camera.pose(), result.camera.values()[-2:]):
        rotation *= -1
        translation += 7
    assert result.camera.description() == before


def test_save_writes_what_is_in_memory(result: malus.Result, tmp_path: Path) -> None:
    result.save(tmp_path)
    workspace = malus.Workspace(tmp_path)
    np.testing.assert_array_equal(workspace.raster("fused/depth.tif"), result.depth)
    np.testing.assert_array_equal(workspace.raster("prior/sigma.tif"), result.prior_sigma)
    assert workspace.quality["warnings"] == result.warnings
    assert workspace.manifest["warnings"] == result.warnings
    assert workspace.options() == malus.Options(refine=QUICK), "not those that were set after the run"


def test_exports_and_report_from_memory(result: malus.Result, tmp_path: Path) -> None:
    mesh = malus.export(result, "ply", tmp_path / "surface.ply")
    assert mesh.read_bytes().startswith(b"ply")
    page = malus.write_report(result, tmp_path / "report.html")
    text = page.read_text(encoding="utf-8")
    assert "in memory" in text and "figures/" not in re.sub(
        r"base64,[^\"]*|<script.*?</script>", "", text, flags=re.DOTALL
    )
    assert sorted(path.name for path in tmp_path.iterdir()) == ["report.html", "surface.ply"]
    with pytest.raises(malus.InputError, match="output is missing"):
        malus.export(result, "ply")
    with pytest.raises(malus.InputError, match="output is missing"):
        malus.write_report(result)


def test_a_result_does_not_stand_for_the_surface_of_a_later_run(
    scene: synthetic.Scene, sensor: synthetic.Sensor, images: list[np.ndarray], tmp_path: Path
) -> None:
    """An export of the first result wrote the surface of the second one, whose run had used the same workspace."""
    station = malus.Station(images, sensor.angles_deg, scene.camera, prior_depth=scene.depth)
    settings = [malus.Options(fusion="grid", grid={"grid_px": cell}) for cell in (8, 16)]
    first, second = (
        malus.reconstruct(station, options, workspace=tmp_path / "work", until="fuse") for options in settings
    )
    with second.in_workspace() as folder:
        np.testing.assert_array_equal(malus.Workspace(folder).raster("fused/depth.tif"), second.depth)
    for use in (first.show, lambda: malus.export(first, "ply", tmp_path / "a.ply"), lambda: malus.write_report(first)):
        with pytest.raises(malus.InputError, match="a later run has replaced the surface of this result"):
            use()
    malus.reconstruct(station, settings[0], workspace=tmp_path / "work", until="fuse")
    with pickle.loads(pickle.dumps(first)).in_workspace() as folder:
        np.testing.assert_array_equal(malus.Workspace(folder).raster("fused/depth.tif"), first.depth)


def test_show_opens_the_report_whatever_the_name(
    result: malus.Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A name with a slash was taken for a folder that does not exist."""
    opened: list[str] = []
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr("webbrowser.open", lambda url: opened.append(url) is None)
    monkeypatch.setattr("malus.report.write_report", lambda _, page: page.with_suffix("").touch() or page)
    page = replace(result, name="left / right").show()
    assert page.with_suffix("").exists() and opened == [page.resolve().as_uri()]


def test_result_of_another_process_has_its_rasters_only(result: malus.Result) -> None:
    sent = pickle.loads(pickle.dumps(result))
    np.testing.assert_array_equal(sent.depth, result.depth)
    with pytest.raises(malus.InputError, match="another process"):
        sent.save("nowhere")


def test_part_of_a_run(scene: synthetic.Scene, sensor: synthetic.Sensor, images: list[np.ndarray]) -> None:
    station = malus.Station(images, sensor.angles_deg, scene.camera)
    part = malus.reconstruct(station, until="polarization")
    assert part.camera is not None and part.degree is not None
    np.testing.assert_allclose(part.camera.translation, scene.camera.translation)
    assert part.depth is None and part.status is None and part.confidence is None
    assert "<img" not in part._repr_html_()


def test_cameras_are_compared_by_their_numbers(scene: synthetic.Scene, result: malus.Result) -> None:
    camera = replace(scene.camera, params=tuple(scene.camera.params), rotation=np.array(scene.camera.rotation))
    assert camera == scene.camera and camera != "camera"
    assert result.camera is not None and replace(result.camera) == result.camera
    for other in ({"model": "OPENCV"}, {"width": 7}, {"params": [100.0, 0.0]}, {"translation": [0, 0, 1]}):
        assert replace(camera, **other) != camera


def test_distorted_cameras_are_refused_for_maps(scene: synthetic.Scene) -> None:
    lens = malus.Camera("OPENCV", scene.camera.width, scene.camera.height, [*scene.camera.params, 0.01, 0, 0, 0])
    with pytest.raises(malus.InputError, match=r"OPENCV.*undistorted\(\)"):
        malus.surface.normals_from_depth(scene.depth, lens)
    plain = lens.undistorted()
    assert plain.model == "PINHOLE"
    np.testing.assert_allclose(plain.params, scene.camera.params)
    expected = malus.surface.normals_from_depth(scene.depth, scene.camera)
    np.testing.assert_array_equal(malus.surface.normals_from_depth(scene.depth, plain), expected)


def test_angles_in_degrees_are_refused(images: list[np.ndarray], sensor: synthetic.Sensor) -> None:
    for degree in (malus.polarization.diffuse_degree, malus.polarization.specular_degree):
        with pytest.raises(ValueError, match="zenith_rad reaches 30, which looks like degrees"):
            degree([0.5, np.nan, 30])
    turned = malus.polarization.decompose(images, np.deg2rad(sensor.angles_deg) + np.pi)
    assert turned.valid.any()


def test_intensities_above_one_are_refused(images: list[np.ndarray], sensor: synthetic.Sensor) -> None:
    with pytest.raises(ValueError, match=r"images\[0\] reaches .*expected linear intensities in \[0, 1\]"):
        malus.polarization.decompose([255 * image for image in images], np.deg2rad(sensor.angles_deg))


@pytest.mark.parametrize("threads", [0, -1])
def test_fewer_threads_than_one_are_refused(
    images: list[np.ndarray], sensor: synthetic.Sensor, scene: synthetic.Scene, threads: int
) -> None:
    """-1, which means all cores elsewhere, gave another surface than 1."""
    station = malus.Station(images, sensor.angles_deg, scene.camera, prior_depth=scene.depth)
    said = f"threads = {threads}, expected at least 1"
    with pytest.raises(malus.InputError, match=said):
        malus.reconstruct(station, threads=threads)
    with pytest.raises(malus.InputError, match=said):
        malus.check(station, threads=threads)
    with pytest.raises(ValueError, match=said):
        malus.polarization.decompose(images, np.deg2rad(sensor.angles_deg), threads=threads)


def test_all_cores_by_default() -> None:
    assert ALL_CORES >= 1
    assert malus.reconstruct.__kwdefaults__["threads"] == ALL_CORES
    steps = (
        "polarization", "capture", "prior", "evidence", "height", "fusion", "surface", "assess", "stereo", "photogrammetry",
    )  # fmt: skip
    functions = [value for step in steps for value in vars(getattr(malus, step)).values() if inspect.isfunction(value)]
    threads = [inspect.signature(function).parameters.get("threads") for function in functions]
    defaults = [parameter.default for parameter in threads if parameter is not None]
    defaults.append(Object.check.__kwdefaults__["threads"])
    assert len(defaults) > 25 and set(defaults) == {ALL_CORES}


def test_glossary_defines_each_term_in_a_sentence() -> None:
    terms = definitions()
    assert len(terms) > 20 and "GSD" in terms
    assert all(text.endswith(".") and "**" not in text for text in terms.values())
