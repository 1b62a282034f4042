"""The whole job on a small station: workspace, resume, interruption, and the same files from both programs."""

from __future__ import annotations

import hashlib
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import markupsafe
import numpy as np
import pytest
import tifffile
from PIL import Image

import malus
from conftest import QUICK, QUICK_WORDS, cloud_of, edit, half_written, malus_here, malus_station, run_program
from conftest import malus as run_malus
from malus.overlay import draw_overlay

RASTERS = [
    "polarization/unpolarized.tif",
    "polarization/degree.tif",
    "polarization/phase.tif",
    "polarization/zenith.tif",
    "polarization/residual.tif",
    "prior/depth.tif",
    "prior/sigma.tif",
    "height/height.tif",
    "fused/depth.tif",
    "fused/normals.tif",
    "fused/sigma.tif",
]
OTHERS = [
    "manifest.json",
    "quality.json",
    "polarization/label.png",
    "polarization/valid.png",
    "fused/camera.txt",
    "fused/image.txt",
    "fused/surface.ply",
    "fused/surface.glb",
    "fused/dem.tif",
]


@pytest.fixture(scope="module")
def finished(finished_grid: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Copy of the finished workspace with its file times, for tests that continue in it."""
    work = tmp_path_factory.mktemp("pipeline") / "work"
    shutil.copytree(finished_grid, work)
    return work


def pinhole(work: Path) -> list[float]:
    """fx, fy, cx and cy of the station's camera."""
    lines = (work / "fused/camera.txt").read_text().splitlines()
    words = next(line for line in lines if "PINHOLE" in line and line[0] != "#").split()
    return [float(word) for word in words[4:8]]


def test_workspace_is_complete(finished: Path) -> None:
    for name in RASTERS:
        raster = tifffile.imread(finished / name)
        assert raster.dtype == np.float32
        assert raster.shape[:2] == (160, 200), name
    for name in [*OTHERS, "report/index.html"]:
        assert (finished / name).stat().st_size > 0, name
    assert not half_written(finished)


def test_time_and_memory_of_every_step_are_recorded(finished: Path) -> None:
    """Of the report, too, which Python makes from the finished workspace."""
    times = malus.Workspace(finished).manifest["times"]
    steps = malus.Workspace(finished).manifest["steps"]
    assert "report" in steps
    for step in steps:
        assert times[step].keys() >= {"seconds", "cpu_seconds", "peak_mb"}, step
    assert times["report"]["cpu_seconds"] > 0.1 and times["report"]["seconds"] > 0.1, "figures included"


def test_normals_are_unit_and_face_the_camera(finished: Path) -> None:
    normals = tifffile.imread(finished / "fused/normals.tif")
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1, atol=1e-5)
    assert (normals[..., 2] < 0).all()


def test_quality_matches_the_rasters(finished: Path) -> None:
    quality = json.loads((finished / "quality.json").read_text())
    assert quality["name"] == "small"
    assert quality["method"] == "grid"
    assert quality["coverage"]["fraction"] == 1.0
    depth = tifffile.imread(finished / "fused/depth.tif").astype(float)
    fx, fy, cx, cy = pinhole(finished)
    v, u = np.mgrid[45:116, 38:158]
    z = depth[45:116, 38:158]
    points = np.stack([(u - cx + 0.5) / fx * z, (v - cy + 0.5) / fy * z, z], -1).reshape(-1, 3)
    distances = np.linalg.svd(points - points.mean(0), full_matrices=False)[1][-1] / np.sqrt(len(points))
    assert quality["patches"][0]["fused"]["rmse"] == pytest.approx(distances, rel=1e-4)
    assert f"{quality['patches'][0]['fused']['rmse_gsd']:.3g}" in (finished / "report/index.html").read_text()


def assert_last_event_is_what_quality_says(events: list[dict[str, Any]], work: Path) -> None:
    quality = json.loads((work / "quality.json").read_text())
    last = events[-1]
    assert last["event"] == "result" and last["assessed"] and last["confidence"] == quality["confidence"]
    assert last["warnings"] == [event["message"] for event in events if event.get("level") == "warning"]
    assert len(last["warnings"]) == len(quality["warnings"])


def test_second_run_repeats_nothing(finished: Path, small_station_source: Path) -> None:
    before = {name: (finished / name).stat().st_mtime_ns for name in RASTERS + OTHERS[1:]}
    outcome = malus_here("assess", small_station_source / "station.toml", "-o", finished, "--fusion", "grid", "--json")
    assert outcome.code == 0, outcome.err
    events = [json.loads(line) for line in outcome.out.splitlines()]
    kept = {event["step"] for event in events if event.get("message") == "kept from an earlier run"}
    assert kept == {"polarization", "prior", "polarizer", "evidence", "zenith", "height", "fuse", "mesh", "assess"}
    assert_last_event_is_what_quality_says(events, finished)
    assert before == {name: (finished / name).stat().st_mtime_ns for name in before}


def test_changed_option_repeats_only_what_depends_on_it(
    finished: Path, small_station_source: Path, tmp_path: Path
) -> None:
    work, station = shutil.copytree(finished, tmp_path / "work"), small_station_source / "station.toml"
    outcome = malus_here("assess", station, "-o", work, "--fusion", "grid", "--json", "--set", "grid.grid_px=8")
    assert outcome.code == 0, outcome.err
    events = [json.loads(line) for line in outcome.out.splitlines()]
    kept = {event["step"] for event in events if event.get("message") == "kept from an earlier run"}
    assert kept == {"polarization", "prior", "polarizer", "evidence", "zenith", "height"}


def assert_close(one: object, other: object) -> None:
    """Equal JSON, numbers to 1e-6."""
    if isinstance(one, dict) and isinstance(other, dict):
        assert list(one) == list(other)
        for key in one:
            assert_close(one[key], other[key])
    elif isinstance(one, list) and isinstance(other, list):
        assert len(one) == len(other)
        for a, b in zip(one, other, strict=True):
            assert_close(a, b)
    elif isinstance(one, float):
        assert one == pytest.approx(other, rel=1e-6, abs=1e-9)
    else:
        assert one == other


def test_executable_makes_the_same_files(finished: Path, small_station_source: Path, tmp_path: Path) -> None:
    work = tmp_path / "work"
    outcome = malus_station(
        small_station_source / "station.toml", "-o", work, "--fusion", "grid", "--threads", "2", "--quiet",
        env={**os.environ, "PATH": "/nonexistent"},
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
    # The same code on the same machine, but vector code in the libraries may round differently with the arrays' alignment.
    # A relative error of the depth tilts the normal by that error times the focal length in pixels.
    for name in RASTERS:
        ours, theirs = (tifffile.imread(w / name) for w in (work, finished))
        tolerance = 2 * np.finfo(np.float32).eps * pinhole(finished)[0] if name == "fused/normals.tif" else 1e-6
        np.testing.assert_allclose(ours, theirs, rtol=1e-6, atol=tolerance, err_msg=name)
    for name in OTHERS[2:]:
        assert (work / name).stat().st_size == (finished / name).stat().st_size, name
        assert name.endswith(".ply") or (work / name).read_bytes() == (finished / name).read_bytes(), name
    assert_close(*(json.loads((w / "quality.json").read_text()) for w in (work, finished)))


def test_one_and_two_threads_agree(finished: Path, small_station_source: Path, tmp_path: Path) -> None:
    work = tmp_path / "work"
    outcome = malus_here(
        "fuse", small_station_source / "station.toml", "-o", work, "--fusion", "grid", "--threads", "1", "--quiet"
    )
    assert outcome.code == 0, outcome.err
    one, two = (tifffile.imread(w / "fused/depth.tif").astype(float) for w in (work, finished))
    gsd = json.loads((finished / "quality.json").read_text())["gsd"]
    assert np.abs(one - two).max() < 1e-3 * gsd


@pytest.mark.parametrize("fusion", ["grid", "refined"])
def test_dropping_maps_changes_no_file(fusion: str, tiny_station_source: Path, tmp_path: Path) -> None:
    station = malus.Station.load(tiny_station_source / "station.toml")
    options = malus.Options(fusion=fusion, refine=QUICK)
    kept = malus.reconstruct(station, options, workspace=tmp_path / "kept", threads=2)
    lean = malus.reconstruct(station, options, workspace=tmp_path / "lean", threads=2, keep_maps=False)
    for name, value in vars(lean).items():
        assert not isinstance(value, np.ndarray), name
    assert kept.normals is not None and kept.zenith_rad is not None and kept.phase_rad is not None
    assert kept.quality is not None and lean.quality is not None
    manifests = [json.loads((tmp_path / work / "manifest.json").read_text()) for work in ("kept", "lean")]
    assert lean.quality == kept.quality
    outputs = [
        {name: output for step in manifest["steps"].values() for name, output in step["outputs"].items()}
        for manifest in manifests
    ]
    assert outputs[0] == outputs[1] and "fused/surface.ply" in outputs[0]


def test_python_arrays_give_the_same_surface(finished: Path, small_station_source: Path) -> None:
    images = [tifffile.imread(p) / np.float32(16383) for p in sorted((small_station_source / "pol").glob("*.tif"))]
    fx, fy, cx, cy = pinhole(finished)
    image_line = next(
        line for line in (finished / "fused/image.txt").read_text().splitlines() if line and line[0] != "#"
    ).split()
    w, x, y, z = (float(word) for word in image_line[1:5])
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    camera = malus.Camera(
        "PINHOLE", 200, 160, [fx, fy, cx - 0.5, cy - 0.5], rotation, [float(t) for t in image_line[5:8]]
    )
    station = malus.Station(
        images,
        [0, 30, 60, 90, 120, 150],
        camera,
        prior_points=cloud_of(small_station_source / "station.toml")["xyz"],
        frames_averaged=16,
        full_well_e=20000,
        read_noise_e=8,
    )
    result = malus.reconstruct(station, malus.Options(fusion="grid"), threads=2)
    expected = tifffile.imread(finished / "fused/depth.tif").astype(float)
    assert result.depth is not None and result.quality is not None
    # The file also has the points' normals, which the array form leaves out; the surfaces agree within the noise.
    assert np.median(np.abs(result.depth - expected)) < 0.5 * result.quality["gsd"]
    assert result.normals is not None and result.normals.shape == (160, 200, 3)


def leaves(command: str, *, surely: bool = True) -> set[str]:
    """Files that the help of a command says it leaves, surely or in some runs."""
    text = malus_here(command, "--help").out
    lines = text[text.index("leaves in WORK:") :].splitlines()[1:]
    return {line.split()[0] for line in lines if ("if there is one" not in line) == surely}


def files_of(work: Path) -> set[str]:
    return {str(path.relative_to(work)) for path in work.rglob("*") if path.is_file() and path.name[0] != "."}


def test_every_command_leaves_what_its_help_says(tiny_station_source: Path, tmp_path: Path) -> None:
    """All in one workspace, each command on the files that the commands before it have left."""
    work = tmp_path / "work"
    for command in ("decompose", "prior", "fuse", "refine", "height", "mesh", "assess"):
        before = files_of(work) if work.exists() else set()
        outcome = malus_here(command, tiny_station_source / "station.toml", "-o", work, "--threads", "2", *QUICK_WORDS)
        assert outcome.code == 0, outcome.err
        assert leaves(command) | before <= files_of(work), command
        further = files_of(work) - before - leaves(command) - {"manifest.json"}
        assert further <= leaves(command, surely=False), command
        if command == "fuse":
            assert "fused/depth.tif" in leaves(command) and "height/height.tif" not in files_of(work)
    assert leaves("refine") == leaves("fuse")
    assert {"fused/dem.tif", "prior/points.png", "fused/trust.png"} <= files_of(work) & leaves("run", surely=False)
    assert malus_here("report", work).code == 0
    assert (work / "report/index.html").stat().st_size > 0
    assert leaves("run") == leaves("demo") == leaves("assess") | {"report/index.html"}
    assert "paper/captions.md, figures and tables" in malus_here("paper", "--help").out


def test_help_of_the_executable_names_the_steps() -> None:
    told = malus_station("--help").out
    steps = ("polarization", "prior", "polarizer", "evidence", "zenith", "height", "fuse", "mesh", "assess")
    assert ", ".join(steps) in " ".join(told[told.index("--until") : told.index("--reference")].split())


def test_grid_fusion_is_no_refinement(tiny_station: Path, tmp_path: Path) -> None:
    work = tmp_path / "work"
    for wrong in (["--fusion", "grid"], ["--set", "fusion=grid"]):
        outcome = malus_here("refine", tiny_station, "-o", work, *wrong)
        assert outcome.code == 2 and "malus fuse" in outcome.err
    assert not work.exists()
    assert malus_here("fuse", tiny_station, "-o", work, "--fusion", "grid", "--quiet").code == 0
    assert "height/height.tif" in files_of(work) and "fused/refinement.json" not in files_of(work)
    outcome = malus_station(tiny_station, "-o", work, "--until", "refine")
    assert outcome.code == 2 and "step refine does not exist, expected one of polarization, " in outcome.err


def test_zenith_and_height_can_be_left_out(tiny_station_source: Path, tmp_path: Path) -> None:
    work = tmp_path / "work"
    options = ["--threads", "2", *QUICK_WORDS, "--set", "assess.polarization_height=false"]
    outcome = malus_here("run", tiny_station_source / "station.toml", "-o", work, *options)
    assert outcome.code == 0, outcome.err
    quality = json.loads((work / "quality.json").read_text())
    assert quality["polarization_height"] is None and quality["patches"][0]["polarization"] is None
    assert not (work / "height").exists() and not (work / "polarization/zenith.tif").exists()
    assert 'id="height"' not in (work / "report/index.html").read_text()


def test_results_of_two_runs_are_not_mixed(finished: Path, small_station_source: Path, tmp_path: Path) -> None:
    """A finished grid run, then another surface in the same workspace: all files made from the first surface must be gone."""
    station = small_station_source / "station.toml"
    work = shutil.copytree(finished, tmp_path / "work")
    (work / "polarization/color.tif").write_bytes(b"of another program")
    outcome = malus_station(station, "-o", work, "--until", "fuse", *QUICK_WORDS, "--quiet")
    assert outcome.code == 0, outcome.err
    for stale in ("quality.json", "fused/surface.ply", "report/index.html"):
        assert not (work / stale).exists(), stale
    outcome = malus_here("report", work)
    assert outcome.code == 2 and "quality.json" in outcome.err and "malus run" in outcome.err
    assert not malus.Workspace(work).has("polarization/color.tif"), "no step has left it"

    assert malus_station(station, "-o", work, *QUICK_WORDS, "--quiet").code == 0
    depth = (work / "fused/depth.tif").read_bytes()
    (work / "fused/depth.tif").write_bytes((finished / "fused/depth.tif").read_bytes())
    outcome = malus_here("report", work)
    assert outcome.code == 2 and "depth.tif: is not as its step left it" in outcome.err
    (work / "fused/depth.tif").write_bytes(depth)
    assert malus_here("report", work).code == 0


def test_recorded_options_are_those_of_the_results(finished: Path, small_station: Path, tmp_path: Path) -> None:
    work = shutil.copytree(finished, tmp_path / "work")
    station = finished_station(small_station, work)
    assert malus_here("prior", station, "-o", work, "--set", "grid.grid_px=99", "--quiet").code == 0
    assert malus.Workspace(work).options().grid.grid_px != 99


def finished_station(station: Path, work: Path) -> Path:
    """The same station in another folder, which takes the workspace over."""
    outcome = malus_here("prior", station, "-o", work, "--fusion", "grid", "--quiet")
    assert outcome.code == 2 and 'belongs to station "small"' in outcome.err and "--replace" in outcome.err
    outcome = malus_here("prior", station, "-o", work, "--fusion", "grid", "--replace", "--json")
    assert outcome.code == 0, outcome.err
    events = [json.loads(line) for line in outcome.out.splitlines()]
    kept = [event["message"] for event in events if event["event"] == "progress"]
    assert kept == ["kept from an earlier run"] * 2, "the inputs are the same"
    return station


def test_folders_with_other_files_are_no_workspace(small_station: Path) -> None:
    for program in (run_malus, malus_station):
        words = ("run",) if program is run_malus else ()
        outcome = program(*words, small_station, "-o", ".", cwd=small_station.parent)
        assert outcome.code == 2
        refused = (
            "not empty and not a workspace" if program is malus_station else "is the folder of the station's inputs"
        )
        assert refused in outcome.err and "work" in outcome.err
    assert not (small_station.parent / "manifest.json").exists()


def test_every_warning_is_in_the_figures_and_on_the_page(tiny_station: Path, tmp_path: Path) -> None:
    """In a quiet run, a step's warning is in its record, in quality.json and in the report; it is repeated when the step is kept."""
    for k, path in enumerate(sorted((tiny_station.parent / "pol").glob("*.tif"))):
        pixels = tifffile.imread(path)
        if k == 2:  # a window of one image changes: many pixels do not follow the sinusoid
            pixels[10:70, 10:50] //= 2
        tifffile.imwrite(path, pixels)
    work = tmp_path / "work"
    command = ("run", tiny_station, "-o", work, "--fusion", "grid", "--threads", "2")
    quiet = malus_here(*command, "--quiet")
    assert quiet.code == 0
    quality = json.loads((work / "quality.json").read_text())
    # Each warning is printed at once, without its step's name, and not again at the end.
    assert all(quiet.err.count(f"warning: {warning.split(': ', 1)[1]}") == 1 for warning in quality["warnings"])
    assert quiet.err.index("warning: ") < quiet.err.index("confidence: partial")
    assert quality["confidence"]["level"] == "partial"
    assert all(reason in quiet.err for reason in quality["confidence"]["reasons"])
    manifest = malus.Workspace(work).manifest
    text = "object's pixels do not follow the polarizer's sinusoid"
    assert any(text in warning for warning in manifest["steps"]["polarization"]["warnings"])
    assert any(warning.startswith("polarization: ") and text in warning for warning in quality["warnings"])
    assert manifest["warnings"] == quality["warnings"]
    page = (work / "report/index.html").read_text()
    # A warning that is a reason for the confidence is not repeated on the page.
    # A reason begins with a capital letter on the page.
    assert all(markupsafe.escape(warning.split(": ", 1)[1][1:]) in page for warning in quality["warnings"])
    assert all(markupsafe.escape(reason[0].upper() + reason[1:]) in page for reason in quality["confidence"]["reasons"])
    outcome = malus_here(*command)
    assert "kept from an earlier run" in outcome.err
    assert text in outcome.err.replace("\n", " "), "repeated"
    assert all(f"warning: {warning}" in outcome.out for warning in quality["warnings"])


def test_runs_that_end_before_the_assessment_say_confidence_and_warnings(tiny_station: Path, tmp_path: Path) -> None:
    """In both programs, with and without --quiet; findings about the inputs count already."""
    path = tiny_station.parent / "pol/pol_060.tif"
    pixels = tifffile.imread(path)
    pixels[10:70, 10:50] //= 2
    tifffile.imwrite(path, pixels)
    work = tmp_path / "work"
    misfits = "object's pixels do not follow the polarizer's sinusoid"
    for command, word in (
        (lambda *words: malus_here("fuse", tiny_station, "-o", work, "--fusion", "grid", *words), "confidence: "),
        (lambda *words: malus_here("mesh", tiny_station, "-o", work, "--fusion", "grid", *words), "confidence: "),
        (
            lambda *words: malus_station(tiny_station, "-o", work, "--fusion", "grid", "--until", "fuse", *words),
            "confidence    ",
        ),
    ):
        quiet, loud = command("--quiet"), command()
        assert quiet.code == loud.code == 0, quiet.err + loud.err
        for said in (quiet.err, loud.err.replace("\n", " ") + loud.out):
            assert f"{word}partial, not assessed yet" in said
            assert said.index(misfits) < said.index(word), "the warning at once, the verdict at the end"
            assert said.rindex(misfits) > said.index(word), "which names it among its reasons"
    quiet = malus_here("decompose", tiny_station, "-o", tmp_path / "maps", "--quiet")
    assert misfits in quiet.err and "confidence" not in quiet.err, "nothing is fused"


def test_provenance_names_everything_that_was_read(tiny_station: Path, tmp_path: Path) -> None:
    folder = tiny_station.parent
    Image.fromarray(np.full((80, 100), 255, np.uint8)).save(folder / "mask.png")
    Image.fromarray(np.ones((80, 100), np.uint8)).save(folder / "labels.png")
    (folder / "response.csv").write_text("0 0\n16383 1\n")
    edit(tiny_station, "white_level = 16383", 'response = "response.csv"\nwhite_level = 16383\nmask = "mask.png"')
    edit(tiny_station, "[prior]", '[optics]\nreflection = "labels.png"\n\n[prior]')
    shutil.copy(folder / "dense/cloud.ply", folder / "scan.ply")
    work = tmp_path / "work"
    outcome = malus_here(
        "assess", tiny_station, "-o", work, "--fusion", "grid", "--reference", folder / "scan.ply", "--quiet"
    )
    assert outcome.code == 0, outcome.err
    manifest = malus.Workspace(work).manifest
    images = {f"pol/pol_{angle:03}.tif" for angle in range(0, 180, 30)}
    files = {"mask.png", "labels.png", "response.csv", "scan.ply", "dense/cloud.ply"}
    assert set(manifest["inputs"]) == images | files | {"sparse/cameras.txt", "sparse/images.txt"}
    for name, recorded in manifest["inputs"].items():
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == recorded, name
    says = manifest["station"]["says"]
    assert says["angle_direction"] == "ccw" and says["white_level"] == 16383
    assert says["camera"]["model"] == "PINHOLE" and says["sha256"]


def test_known_distances_of_a_given_prior_are_reported(tiny_station_source: Path, tmp_path: Path) -> None:
    """The error of a distance that was held out was only logged."""
    station = tmp_path / "tiny" / "station.toml"
    shutil.copytree(tiny_station_source, station.parent)
    bars = "".join(
        f"\n[[scale]]\ndistance = {distance}\na_xyz = [0, 0, 0]\nb_xyz = [10, 0, 0]\ncheck = {check}\n"
        for distance, check in ((10, "false"), (10.01, "true"))
    )
    station.write_text(station.read_text() + bars)
    outcome = malus_here("run", station, "-o", tmp_path / "work", "--fusion", "grid", "--threads", "2")
    assert outcome.code == 0, outcome.err
    scale = malus.Workspace(tmp_path / "work").quality["prior_scale"]
    assert scale["scale"] == pytest.approx(1) and scale["distances"][0]["residual"] == 0
    held_out = scale["distances"][1]
    assert held_out["check"] and held_out["residual"] == pytest.approx(-0.01)
    assert 'data-path="prior_scale.distances.1.residual"' in (tmp_path / "work/report/index.html").read_text()


def test_decompose_needs_no_prior(small_station: Path, tmp_path: Path) -> None:
    edit(small_station, '[prior]\ncloud = "dense/cloud.ply"\n', "")
    outcome = malus_here("decompose", small_station, "-o", tmp_path / "work", "--quiet")
    assert outcome.code == 0, outcome.err
    refused = malus_here("run", small_station, "-o", tmp_path / "work", "--quiet")
    assert refused.code == 2 and "only `decompose` and `height` can be run" in refused.err
    checked = malus_here("check", small_station)
    assert "what polarization alone tells" in checked.out and "height: height from polarization alone" in checked.out
    assert "picture of image and mask: station-check.png" in checked.out


def test_check_lists_what_a_run_would_do(small_station: Path, tmp_path: Path) -> None:
    outcome = malus_here("check", small_station, "--json")
    assert outcome.code == 0, outcome.err
    plan = json.loads(outcome.out)
    assert (plan["width"], plan["height"], plan["object_pixels"]) == (200, 160, 32000)
    assert plan["seconds"] > 0 and plan["memory_mb"] > 0
    assert any("points fall on the object" in line for line in plan["does"])
    assert not any("memory" in line for line in plan["warnings"])
    assert plan["confidence"] == {"level": None, "reasons": []}


def test_check_states_known_doubts_about_the_result(small_station: Path, tmp_path: Path) -> None:
    edit(small_station, 'unit = "mm"', 'unit = "m"')
    outcome = malus_here("check", small_station, "--json")
    assert outcome.code == 0, outcome.err
    plan = json.loads(outcome.out)
    assert plan["confidence"]["level"] == "low"
    assert plan["confidence"]["reasons"] and set(plan["confidence"]["reasons"]) <= set(plan["warnings"])


def test_both_programs_end_with_the_confidence(small_station: Path, tmp_path: Path) -> None:
    for number, (program, words) in enumerate(
        ((run_malus, ("decompose",)), (malus_station, ("--until", "polarization")))
    ):
        before, after = (words, ()) if program is run_malus else ((), words)
        outcome = program(*before, small_station, "-o", tmp_path / str(number), *after, "--json")
        assert outcome.code == 0, outcome.err
        last = json.loads(outcome.out.splitlines()[-1])
        assert last["event"] == "result" and last["confidence"] is None and not last["assessed"]


def test_check_leaves_a_picture_of_cloud_and_image(small_station: Path, tmp_path: Path) -> None:
    outcome = malus_here("check", small_station)
    assert outcome.code == 0, outcome.err
    assert "picture of the coarse surface on the image: station-check.png" in outcome.out
    assert "200 x 160 px, 32000 on the object\n" in outcome.out
    right = np.asarray(Image.open(tmp_path / "station-check.png"))
    assert right.ndim == 3 and min(right.shape[:2]) > 400
    image, mask, points = malus._core.check_picture(malus.Station.load(small_station)._core, 1)
    assert image.shape == mask.shape == (160, 200)
    assert points.shape[1] == 3 and points[:, 0].min() > -0.5 and points[:, 1].max() < 159.5
    half = draw_overlay(image, mask, points[points[:, 0] < 100], "half $1_$", "mm", ["Said of $2_$."])
    whole = draw_overlay(image, mask, points, "half $1_$", "mm", ["Said of $2_$."])

    def colored(png: bytes) -> int:
        pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)
        return int((np.ptp(pixels, axis=-1) > 40).sum())

    assert 0.3 * colored(whole) < colored(half) < 0.75 * colored(whole)  # half of the points, and the scale


def test_check_leaves_the_picture_of_a_cloud_that_misses_the_object_too(small_station: Path, tmp_path: Path) -> None:
    mask = np.zeros((160, 200), np.uint8)
    mask[0, 0] = 255
    Image.fromarray(mask).save(small_station.parent / "mask.png")
    edit(small_station, "white_level = 16383", 'white_level = 16383\nmask = "mask.png"')
    outcome = malus_here("check", small_station, "--overlay", tmp_path / "seen.png")
    assert outcome.code == 3 and "points fall on the object" in outcome.err
    assert (tmp_path / "seen.png").exists()


def test_check_warns_of_too_little_memory(small_station: Path, tmp_path: Path) -> None:
    # As a program of its own: the threads that it starts would stay in this process.
    outcome = run_malus("check", small_station, "--json", "--threads", "100000")
    assert outcome.code == 0, outcome.err
    assert any("GB of memory, of which it may have" in line for line in json.loads(outcome.out)["warnings"])


def test_ctrl_c_stops_within_a_second_and_leaves_nothing_half_done(small_station: Path, tmp_path: Path) -> None:
    work = tmp_path / "work"
    command = [
        sys.executable,
        "-m",
        "malus.cli",
        "assess",
        str(small_station),
        "-o",
        str(work),
        "--fusion",
        "grid",
        "--json",
    ]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=dict(os.environ)
    ) as process:
        assert process.stdout is not None and process.stderr is not None
        for line in process.stdout:
            if json.loads(line)["step"] == "height":
                break
        start = time.monotonic()
        process.send_signal(signal.SIGINT)
        process.stdout.read()
        error = process.stderr.read()
        process.wait(timeout=30)
    assert time.monotonic() - start < 2.0  # one second, and what a loaded test machine adds
    assert process.returncode == 130
    assert "Traceback" not in error
    manifest = json.loads((work / "manifest.json").read_text())
    assert set(manifest["steps"]) == {"polarization", "prior", "polarizer", "evidence", "zenith"}
    assert not half_written(work)
    outcome = malus_here("assess", small_station, "-o", work, "--fusion", "grid", "--json")
    assert outcome.code == 0, outcome.err
    kept = {
        e["step"] for e in map(json.loads, outcome.out.splitlines()) if e.get("message") == "kept from an earlier run"
    }
    assert kept == {"polarization", "prior", "polarizer", "evidence", "zenith"}


def test_help_and_version() -> None:
    assert run_malus("--version").out.strip() == f"malus {malus.__version__}"
    assert "STATION.toml" in malus_here("run", "--help").out
    assert malus_station("--version").code == 0


def test_python_is_not_needed_by_the_executable() -> None:
    program = Path(os.environ.get("MALUS_STATION", Path(__file__).parents[2] / "build/malus-station"))
    if not program.exists():
        pytest.skip("malus-station is not built")
    assert "python" not in run_program("ldd", program).out
