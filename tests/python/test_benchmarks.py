"""The benchmarks without their renderer: random draws, the change that each variant makes, scoring, judging and tables."""

from __future__ import annotations

import importlib
import json
import re
import shutil
import subprocess
import sys
import tomllib
from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image

from conftest import ROOT

sys.path.insert(0, str(ROOT / "benchmarks"))
harm: Any = importlib.import_module("harm")
random_stations: Any = importlib.import_module("random_stations")
smith2016: Any = importlib.import_module("smith2016")
station_variants: Any = importlib.import_module("station_variants")
Variant = station_variants.Variant

WIDTH, HEIGHT, FOCAL, GSD = 60, 50, 300.0, 2.0
K = np.array([[FOCAL, 0, 29.5], [0, FOCAL, 24.5], [0, 0, 1.0]])
# A camera that is neither at the origin nor aligned with the world's axes: x_cam = R x + t.
R = station_variants.turn(np.array([0.6, 0.0, 0.8]), 0.7)
T = np.array([5.0, -3.0, 600.0])


def in_camera(cloud: NDArray[Any]) -> NDArray[np.float64]:
    return np.asarray(np.stack([cloud[axis] for axis in "xyz"], -1).astype(float) @ R.T + T)


def normals_in_camera(cloud: NDArray[Any]) -> NDArray[np.float64]:
    return np.asarray(np.stack([cloud["n" + axis] for axis in "xyz"], -1).astype(float) @ R.T)


@pytest.fixture
def station(tmp_path: Path) -> Path:
    """A folder as the renderer writes it: a bulge in front of the camera, with its cloud."""
    folder = tmp_path / "rendered"
    (folder / "dense").mkdir(parents=True)
    (folder / "gt").mkdir()
    v, u = np.indices((HEIGHT, WIDTH))
    depth = 600 - 8 * np.exp(-((u - 30) ** 2 + (v - 25) ** 2) / 300)
    points = np.stack([(u - K[0, 2]) / FOCAL * depth, (v - K[1, 2]) / FOCAL * depth, depth], -1).reshape(-1, 3)
    kinds = [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")] + [("red", "u1")]
    cloud = np.zeros(len(points), kinds)
    world, normal = (points - T) @ R, np.array([0, 0, -1.0]) @ R
    for k, axis in enumerate("xyz"):
        cloud[axis], cloud["n" + axis] = world[:, k], normal[k]
    station_variants.write_cloud(folder / "dense/mvs_cloud.ply", cloud)
    names = json.dumps([f"pol/pol_{angle:03d}.png" for angle in range(0, 180, 30)])
    text = f'[polarized]\nimages = {names}\nangle_direction = "ccw"\nresponse = "linear"\nmask = "mask.png"\n'
    text += '[camera]\ncolmap_model = "gt_sparse"\n[prior]\ncloud = "dense/mvs_cloud.ply"\n[[patch]]\nname = "flat"\n'
    for name in ("station.toml", "station_noisy.toml"):
        (folder / name).write_text(text.replace("pol/", "noisy/") if "noisy" in name else text)
    camera = dict(K=K.tolist(), R_world_to_cam=R.tolist(), t_world_to_cam=T.tolist(), width=WIDTH)
    meta = dict(scene="bulge", gsd_mm=GSD, station=camera, material=dict(bsdf="pplastic"))
    (folder / "meta.json").write_text(json.dumps(meta))
    np.savez(folder / "gt/depth_normal_mask.npz", depth=depth, label=np.ones((HEIGHT, WIDTH), np.uint8))
    return folder


def variant(name: str, **amount: Any) -> Any:
    return Variant("prior" if name in station_variants.PRIOR_ERRORS else "setting", name, amount=amount)


def changed_cloud(station: Path, what: Any, folder: Path) -> tuple[NDArray[Any], NDArray[Any]]:
    """The station's cloud and the variant's."""
    station_variants.write(station, what, folder)
    return station_variants.read_cloud(station / "dense/mvs_cloud.ply"), station_variants.read_cloud(
        folder / "cloud.ply"
    )


def test_half_of_the_variants_are_correct_and_every_error_is_drawn() -> None:
    drawn = [station_variants.draw(np.random.default_rng([1, k])) for k in range(2000)]
    kinds = Counter(v.kind for v in drawn)
    assert kinds["correct"] == pytest.approx(1000, abs=100)
    assert kinds["prior"] == pytest.approx(500, abs=80)
    settings = station_variants.IMAGE_SETTINGS + station_variants.CLOUD_SETTINGS
    assert {v.name for v in drawn} == {"correct", *station_variants.PRIOR_ERRORS, *settings}
    assert station_variants.draw(np.random.default_rng([1, 7])) == drawn[7]
    assert all(v.amount["order"] != list(range(6)) for v in drawn if v.name == "order")


def test_a_correct_variant_leaves_the_inputs_unchanged(station: Path, tmp_path: Path) -> None:
    path = station_variants.write(station, Variant("correct", "correct", noisy=True), tmp_path / "out")
    tables = tomllib.loads(path.read_text())
    assert tables["polarized"]["images"][1] == str(station / "noisy/pol_030.png")
    assert tables["polarized"]["mask"] == str(station / "mask.png")
    assert tables["camera"]["colmap_model"] == str(station / "gt_sparse")
    assert tables["prior"]["cloud"] == "cloud.ply"
    before = station_variants.read_cloud(station / "dense/mvs_cloud.ply")
    after = station_variants.read_cloud(tmp_path / "out/cloud.ply")
    np.testing.assert_allclose(in_camera(after), in_camera(before), atol=1e-4)
    assert (after["red"] == before["red"]).all()


def test_a_wrong_setting_changes_nothing_else_in_the_station_file(station: Path, tmp_path: Path) -> None:
    amounts: dict[str, dict[str, Any]] = {
        "direction": dict(angle_direction="cw"),
        "zero": dict(angle_zero_deg=-35.0),
        "response": dict(response="srgb"),
    }
    right = tomllib.loads(
        station_variants.write(station, Variant("correct", "correct"), tmp_path / "right").read_text()
    )
    for name, amount in amounts.items():
        wrong = tomllib.loads(station_variants.write(station, variant(name, **amount), tmp_path / name).read_text())
        assert wrong["polarized"] == right["polarized"] | amount
    path = station_variants.write(station, variant("order", order=[1, 0, 2, 3, 4, 5]), tmp_path / "order")
    images = tomllib.loads(path.read_text())["polarized"]["images"]
    assert [Path(name).name for name in images[:2]] == ["pol_030.png", "pol_000.png"]


def test_bias_and_shift_move_the_cloud_along_and_across_the_view(station: Path, tmp_path: Path) -> None:
    before, after = changed_cloud(station, variant("bias", gsd=-5.0), tmp_path / "bias")
    np.testing.assert_allclose(in_camera(after) - in_camera(before), [[0, 0, -5 * GSD]] * len(before), atol=1e-3)
    before, after = changed_cloud(station, variant("shifted", share=0.1, axis_deg=90.0), tmp_path / "shifted")
    np.testing.assert_allclose(
        in_camera(after) - in_camera(before), [[0, 0.1 * GSD * WIDTH, 0]] * len(before), atol=1e-3
    )


def test_scale_and_unit(station: Path, tmp_path: Path) -> None:
    before, after = changed_cloud(station, variant("scale", factor=1.04), tmp_path / "scale")
    np.testing.assert_allclose(np.ptp(in_camera(after), axis=0), 1.04 * np.ptp(in_camera(before), axis=0), rtol=1e-4)
    np.testing.assert_allclose(np.median(in_camera(after), 0), np.median(in_camera(before), 0), atol=1e-3)
    before, after = changed_cloud(station, variant("unit", factor=0.1), tmp_path / "unit")
    np.testing.assert_allclose(after["z"], 0.1 * before["z"], atol=1e-5)


@pytest.mark.parametrize(("name", "axis"), [("tilt", [0.0, 1.0, 0.0]), ("turned", [0.0, 0.0, 1.0])])
def test_rotations_keep_their_axis_and_rotate_the_normals_too(
    station: Path, tmp_path: Path, name: str, axis: list[float]
) -> None:
    before, after = changed_cloud(station, variant(name, deg=3.0, axis_deg=90.0), tmp_path / name)
    a, b = (in_camera(c) - np.median(in_camera(before), 0) for c in (before, after))
    np.testing.assert_allclose(b @ axis, a @ axis, atol=1e-3)
    far = np.linalg.norm(np.cross(a, axis), axis=1) > 10
    turned = np.cross(a, axis), np.cross(b, axis)
    cosine = (turned[0] * turned[1]).sum(1) / np.linalg.norm(turned[0], axis=1) / np.linalg.norm(turned[1], axis=1)
    np.testing.assert_allclose(np.degrees(np.arccos(cosine[far])), 3, atol=0.02)
    angle = np.degrees(np.arccos((normals_in_camera(after) * normals_in_camera(before)).sum(1)))
    np.testing.assert_allclose(angle, 3 if name == "tilt" else 0, atol=0.05)


def test_a_mirrored_cloud_has_left_and_right_exchanged(station: Path, tmp_path: Path) -> None:
    before, after = changed_cloud(station, variant("mirrored"), tmp_path / "mirrored")
    a, b = in_camera(before), in_camera(after)
    np.testing.assert_allclose(b[:, 0], 2 * np.median(a[:, 0]) - a[:, 0], atol=1e-3)
    np.testing.assert_allclose(b[:, 1:], a[:, 1:], atol=1e-3)


def test_holes_remove_the_requested_share(station: Path, tmp_path: Path) -> None:
    before, after = changed_cloud(station, variant("holes", share=0.5, seed=3), tmp_path / "holes")
    assert 0.3 < len(after) / len(before) < 0.5
    assert set(map(tuple, after.tolist())) < set(map(tuple, before.tolist()))


def truth_and_mask(station: Path) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    truth = np.load(station / "gt/depth_normal_mask.npz")
    return truth["depth"], harm.scored_pixels(truth["label"])


def test_the_score_of_known_errors(station: Path) -> None:
    truth, mask = truth_and_mask(station)
    assert mask.sum() == (HEIGHT - 12) * (WIDTH - 12)
    assert harm.figures(truth + 7, truth, mask, K, GSD)["rmse"] < 1e-9  # a constant is taken out
    noise = np.random.default_rng(0).standard_normal(truth.shape)
    noisy = harm.figures(truth + GSD * noise, truth, mask, K, GSD)
    assert noisy["rmse"] == pytest.approx(1, rel=0.1)
    assert noisy["detail_mad"] == pytest.approx(1, rel=0.1)
    u = np.arange(WIDTH)[None, :] - K[0, 2]
    tilted = harm.figures(truth + np.tan(np.radians(5)) * GSD * u, truth, mask, K, GSD)
    assert tilted["normal_median"] == pytest.approx(5, abs=0.6)
    assert tilted["detail_mad"] < 0.2 * tilted["rmse"]  # the mask's border bends the lowpass a little


def result(level: str | None = "high", ratio: float = 1.0, name: str = "correct", code: int = 0, **more: Any) -> Any:
    kind = "correct" if name == "correct" else "prior" if name in station_variants.PRIOR_ERRORS else "setting"
    ran = dict(level=level, ratios=dict.fromkeys(harm.FIGURES, 1.0) | {"detail_mad": ratio}) if code == 0 else {}
    what = dict(kind=kind, name=name, noisy=False, good_cloud=False, amount={})
    base = dict(name="s", draw=0, scene="x", light="sun", metal=False, exit_code=code, message="why", variant=what)
    return base | ran | more


def test_what_counts_as_harm_and_what_marks_it() -> None:
    assert harm.is_unmarked(result("high", 1.2))
    assert harm.is_unmarked(result(None, 1.2))  # a result without a confidence level is not marked
    assert harm.is_harm(result("partial", 1.2)) and not harm.is_unmarked(result("partial", 1.2))
    assert harm.is_harm(result(ratio=float("nan")))
    assert not harm.is_harm(result(ratio=1.05))
    assert harm.is_gain(result(ratio=0.5)) and not harm.is_gain(result(ratio=1.0))
    assert harm.is_kept(result(ratio=1.001)) and not harm.is_kept(result(ratio=0.9))
    assert harm.is_refused(result(code=2)) and not harm.is_failure(result(code=2))
    assert harm.is_failure(result(code=2, message=""))
    assert harm.is_failure(result(code=-11))


def test_the_counts_of_a_table_row() -> None:
    row = harm.counts([result(ratio=0.5), result("low", 0.7), result("partial", 1.5), result(code=2)])
    assert (row["stations"], row["gain"], row["harm"], row["low"], row["refused"]) == (4, 2, 1, 1, 1)
    assert row["median_ratios"]["detail_mad"] == pytest.approx(0.7)
    assert harm.counts([result(code=2)])["median_ratios"]["rmse"] is None


def test_the_bars_leave_out_wrong_priors_and_metals() -> None:
    good = [result(ratio=0.5) for _ in range(20)]
    held = harm.bars([*good, result("high", 3.0, "shifted"), result("low", metal=True)])
    assert all(bar["held"] for bar in held.values())
    assert held["unmarked harm, prior itself wrong"]["count"] == 1
    missed = harm.bars([*good, result("high", 3.0, "response"), result("low"), result(code=3)])
    assert not missed["unmarked harm"]["held"] and not missed["low or refused of correct"]["held"]
    assert missed["low or refused of correct"]["count"] == 2
    assert not harm.bars([*good, result(code=-11)])["failed"]["held"]


FAKE = """#!{python}
# Stands in for malus-station and for `malus run`: a prior with an error and a fused surface without, or an error message.
import json, sys, tomllib
from pathlib import Path
import numpy as np, tifffile
words = sys.argv[1:]
place = words.index("-o")
station, work = Path(words[1 if words[0] == "run" else 0]), Path(words[place + 1])
if tomllib.loads(station.read_text())["polarized"].get("response") != "linear":
    sys.stderr.write("response is wrong")
    sys.exit(2)
truth = np.load({truth!r})["depth"]
rough = truth + np.random.default_rng(0).standard_normal(truth.shape)
for name, depth in (("prior", rough), ("fused", truth)):
    (work / name).mkdir(parents=True)
    tifffile.imwrite(work / name / "depth.tif", depth.astype(np.float32))
quality = dict(status="converged", warnings=[], confidence=dict(level="high", reasons=[]))
(work / "quality.json").write_text(json.dumps(quality))
"""


def test_a_run_from_the_variant_to_the_tables(
    station: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / "fake"
    program.write_text(FAKE.format(python=sys.executable, truth=str(station / "gt/depth_normal_mask.npz")))
    program.chmod(0o755)
    out = tmp_path / "out"
    arguments = ["harm.py", str(station), "--executable", str(program), "-o", str(out), "--draws", "6", "--jobs", "2"]
    monkeypatch.setattr(sys, "argv", arguments)
    assert harm.main() == 0
    written = json.loads((out / "harm.json").read_text())
    assert written["tables"]["scene"]["bulge"]["stations"] == 6
    assert written["bars"]["unmarked harm"]["count"] == 0
    ran = [r for r in written["stations"] if r["exit_code"] == 0]
    assert ran and all(r["ratios"]["detail_mad"] < 0.01 for r in ran)
    assert "unmarked harm: 0 of" in capsys.readouterr().out
    # A second call runs no station again: the files in each workspace are still there.
    marker = out / f"{station.name}_0" / "marker"
    marker.touch()
    assert harm.main() == 0
    assert marker.exists()
    # From photographs, the station's own file is run.
    shutil.copy(station / "station.toml", station / "station_photos.toml")
    arguments = ["harm.py", "--from-photos", str(station), "--executable", str(program), "-o", str(tmp_path / "photos")]
    monkeypatch.setattr(sys, "argv", arguments)
    assert harm.main() == 0
    written = json.loads((tmp_path / "photos/harm.json").read_text())
    assert written["tables"]["variant"]["correct: from photos"]["gain"] == 1
    (station / "station_photos.toml").unlink()
    with pytest.raises(SystemExit):
        harm.main()
    assert "station_photos.toml" in capsys.readouterr().err


def test_random_stations_are_drawn_from_a_pool_of_renders(station: Path) -> None:
    pool = station.parent / "pool"
    for name in ("a", "b", "round/st0", "round/st1", "unfinished"):
        shutil.copytree(station, pool / name)
    (pool / "round/object.toml").touch()
    (pool / "unfinished/meta.json").unlink()
    tasks = harm.tasks_of_renders([pool], 9, 1)
    drawn = [task.station.relative_to(pool.resolve()).parts[0] for task in tasks]
    for first in (0, 3, 6):  # each object is drawn once before any is drawn again
        assert sorted(drawn[first : first + 3]) == ["a", "b", "round"]
    assert all(task.variant.sensor for task in tasks) and len({task.name + str(task.draw) for task in tasks}) == 9
    assert harm.tasks_of_renders([pool], 9, 1) == tasks != harm.tasks_of_renders([pool], 9, 2)


@pytest.mark.parametrize("noisy", [False, True])
def test_a_drawn_sensor_adds_the_noise_that_the_station_file_states(station: Path, tmp_path: Path, noisy: bool) -> None:
    rendered = tomllib.loads((station / "station.toml").read_text())["polarized"]
    size, light, white = (400, 300), 0.4, 16383
    (station / "pol").mkdir()
    random = np.random.default_rng(0)
    sigma = np.sqrt((light * 20000 + 64) / 16) / 20000
    for name in rendered["images"]:
        image = light + sigma * random.standard_normal(size)
        Image.fromarray(np.rint(white * image).astype(np.uint16)).save(station / name)
    text = (station / "station.toml").read_text()
    numbers = f"frames_averaged = 16\nfull_well_e = 20000\nread_noise_e = 8\nwhite_level = {white}\n"
    (station / "station.toml").write_text(text.replace("[camera]", numbers + "[camera]"))
    sensor = dict(full_well=0.5, read_noise=2.0, seed=3)
    path = station_variants.write(station, Variant("correct", "correct", noisy, sensor=sensor), tmp_path / "out")
    said = tomllib.loads(path.read_text())["polarized"]
    assert (said["full_well_e"], said["read_noise_e"], said["frames_averaged"]) == (10000, 16, 1 if noisy else 16)
    expected = np.sqrt((light * 10000 + 256) / said["frames_averaged"]) / 10000
    first = tifffile.imread(path.parent / said["images"][0]) / white  # the only image that is not moved
    assert first.std() == pytest.approx(expected, rel=0.02)
    assert first.mean() == pytest.approx(light, abs=3e-4)


def test_moved_images_are_shifted_by_a_pixel_or_so() -> None:
    u = np.indices((60, 80), dtype=float)[1]
    shifts = [station_variants.moved(u, np.random.default_rng(seed))[5:-5, 5:-5] - u[5:-5, 5:-5] for seed in range(20)]
    means = [shift.mean() for shift in shifts]
    assert 0.3 < np.abs(means).mean() < 0.8 and np.abs(means).max() < 1.1
    assert max(np.ptp(shift) for shift in shifts) < 0.1  # by the rotation


def test_scoring_reads_the_workspace(station: Path, tmp_path: Path) -> None:
    truth, _ = truth_and_mask(station)
    noise = np.random.default_rng(0).standard_normal(truth.shape)
    for name, factor in (("prior", 1.0), ("fused", 2.0)):
        (tmp_path / name).mkdir()
        tifffile.imwrite(tmp_path / name / "depth.tif", (truth + factor * noise).astype(np.float32))
    assert harm.score(station, tmp_path)["ratios"]["rmse"] == pytest.approx(2, rel=0.01)
    tifffile.imwrite(tmp_path / "fused/depth.tif", np.full(truth.shape, np.nan, np.float32))
    assert harm.score(station, tmp_path) == {}


# --- random stations


def description(**station: Any) -> dict[str, Any]:
    """The fields of a renderer's scene that the benchmark reads."""
    corners = np.array([[-30, -20, 0], [30, 20, 12.0]])
    mesh = dict(label=1, V=corners, bsdf=dict(type="pplastic", int_ior=1.5, alpha=0.2))
    board = dict(label=2, V=corners * 9, bsdf=dict(type="pplastic", int_ior=1.5, alpha=0.35))
    return dict(meshes=[mesh, board], stations=[dict(dist=500, **station)], views=dict(dist=540), material={})


@pytest.mark.parametrize("station", [dict(tilt=(4.0, -5.0)), dict(direction=[0.3, 0.4, 0.9])])
def test_lamps_stand_above_the_support_and_out_of_the_photographs(station: dict[str, Any]) -> None:
    lights = SimpleNamespace(softbox=lambda center, size, radiance, target, up: (center, size), constant=lambda r: r)
    sc = description(**station)
    up = 1 if "direction" in station else 2
    for seed in range(200):
        light = random_stations.RandomLight(lights, sc, np.random.default_rng(seed))
        assert light.radius == pytest.approx(np.linalg.norm([60, 40, 12]) / 2)  # of the object, not of the board
        _, drawn = light.softbox((15, 82))
        assert drawn["to_light"][up] > 0.05
        half_angle = np.degrees(np.arctan(drawn["side"] / drawn["distance"] / 2))
        assert drawn["zenith_deg"] - half_angle > 30 or drawn["distance"] > 540


def test_every_light_is_drawn_reproducibly() -> None:
    lights = SimpleNamespace(
        softbox=lambda *a, **k: ("softbox", a, k), constant=lambda r: ("constant", r),
        directional=lambda *a: ("sun", a), room=lambda f: ("room", f(np.eye(3))), rectangle_in_room=lambda d, *a: d[..., 0] > 0.9,
    )  # fmt: skip
    for kind in random_stations.LIGHTS:
        first, second = (
            random_stations.RandomLight(lights, description(tilt=(4, -5)), np.random.default_rng(5)).draw(kind)
            for _ in range(2)
        )
        assert repr(first) == repr(second) and first[0]
    raking = random_stations.RandomLight(lights, description(tilt=(0, 0)), np.random.default_rng(1)).draw("raking")[1]
    assert 69 < raking["boxes"][0]["zenith_deg"] < 85


def test_material_is_drawn_for_dielectrics_and_metals_keep_theirs() -> None:
    said = []
    for seed in range(40):
        sc = description()
        drawn = random_stations.draw_material(sc, np.random.default_rng(seed))
        assert sc["meshes"][0]["bsdf"]["int_ior"] == drawn["refractive_index"]
        assert sc["meshes"][1]["bsdf"]["int_ior"] == 1.5
        assert 1.3 <= drawn["refractive_index"] <= 2 and 0.03 <= drawn["roughness"][0] <= 0.5
        assert sc["material"]["refractive_index"] == drawn["index_said"]
        said.append(drawn["index_said"] == 1.5)
    assert 10 < sum(said) < 30
    metal = description()
    metal["meshes"][0]["bsdf"] = dict(type="roughconductor", alpha=0.1)
    assert random_stations.draw_material(metal, np.random.default_rng(0)) == dict(metal=True)
    assert metal["meshes"][0]["bsdf"] == dict(type="roughconductor", alpha=0.1)


def test_a_folder_of_random_stations_has_one_size_and_density(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A second run with another --scale left the stations as they were, and said nothing."""
    rendered: list[list[str]] = []

    def render() -> None:
        rendered.append(sys.argv)
        Path(sys.argv[sys.argv.index("--out") + 1]).mkdir(parents=True)

    scenes = SimpleNamespace(SCENES={"coin": SimpleNamespace(STYLES={})})
    modules = dict(render=SimpleNamespace(main=render), lights=None, noise=SimpleNamespace(), scenes=scenes)
    monkeypatch.setattr(random_stations, "import_untyped", modules.__getitem__)
    monkeypatch.setattr(sys, "path", [*sys.path])
    (tmp_path / "render.py").touch()

    def run(arguments: str) -> int:
        command = f"random_stations.py --renderer {tmp_path} -o {tmp_path}/out --count 2 --scenes coin {arguments}"
        monkeypatch.setattr(sys, "argv", command.split())
        return int(random_stations.main())

    assert run("--scale 2") == 0 and len(rendered) == 2
    drawn = [json.loads(path.read_text()) for path in (tmp_path / "out").glob("*/random.json")]
    assert all((station["scale"], station["quality"]) == (2, 0.4) for station in drawn) and len(drawn) == 2
    assert all(station["photos"] == 0 for station in drawn)
    assert "400x300" in rendered[0]
    assert run("--scale 2") == 0 and len(rendered) == 2
    with pytest.raises(SystemExit, match="not made with this scale,"):
        run("--scale 3")
    with pytest.raises(SystemExit, match="not made with this quality,"):
        run("--scale 2 --quality 1")
    with pytest.raises(SystemExit, match="not made with this photos,"):
        run("--scale 2 --photos 10")
    with pytest.raises(SystemExit):
        run("--scale 0")
    assert "--scale 0: expected 1 or more" in capsys.readouterr().err
    assert len(rendered) == 2


@pytest.mark.parametrize(("surface", "printed_deg"), [("sphere", 0.78), ("bumps", 1.21)])
def test_height_from_polarization_alone_has_the_printed_figures(surface: str, printed_deg: float) -> None:
    """docs/method.md, section 2: six angles, 0.5 % noise; Smith et al. 2016 have 4.3 and 7.7 degrees there."""
    data = smith2016.imaged(getattr(smith2016, surface)(), 0.005)
    assert smith2016.errors(data, ["likelihood"])["likelihood"] == pytest.approx(printed_deg, abs=0.06)


#: Stands in for malus-station: its result is the truth plus a step of one GSD, half as high in the prior; it fails with Eq 16 alone.
_PROGRAM = """#!{python}
import json, sys
from pathlib import Path
import numpy as np
import tifffile
if "optimize.enabled=false" in sys.argv:
    sys.exit("no light")
scene, work = Path(sys.argv[1]).parent, Path(sys.argv[3])
truth = np.load(scene / "gt/depth_normal_mask.npz")["depth"]
step = np.where(np.indices(truth.shape)[1] < truth.shape[1] // 2, {gsd} / 2, -{gsd} / 2)
for name, share in (("fused", 1), ("prior", 0.5)):
    (work / name).mkdir(parents=True)
    tifffile.imwrite(work / name / "depth.tif", (truth + share * step).astype(np.float32))
tifffile.imwrite(work / "fused/sigma.tif", np.full(truth.shape, {gsd}, np.float32))
k = json.loads((scene / "meta.json").read_text())["station"]["K"]
(work / "fused/camera.txt").write_text(
    "1 PINHOLE %d %d %r %r %r %r" % (*truth.shape[::-1], k[0][0], k[1][1], k[0][2] + 0.5, k[1][2] + 0.5)
)
(work / "quality.json").write_text(json.dumps({{"confidence": {{"level": "high"}}}}))
seconds = 1 + len(sys.argv)  # every run takes another time
(work / "manifest.json").write_text(json.dumps({{"times": {{"a": {{"cpu_seconds": 2}}, "b": {{"cpu_seconds": seconds}}}}}}))
"""


def test_rendered_scenes_are_run_scored_and_tabled(station: Path, tmp_path: Path) -> None:
    truth = dict(np.load(station / "gt/depth_normal_mask.npz"))
    np.savez(station / "gt/depth_normal_mask.npz", **truth, mask=np.ones((HEIGHT, WIDTH), bool))
    program = tmp_path / "program"
    program.write_text(_PROGRAM.format(python=sys.executable, gsd=GSD))
    program.chmod(0o755)
    command = [sys.executable, ROOT / "benchmarks/rendered/run.py", "-o", tmp_path / "out", "--data", tmp_path]
    done = subprocess.run([*command, "--program", program], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    (figures,) = json.loads((tmp_path / "out/figures.json").read_text()).values()
    assert figures["refined"]["rmse_gsd"] == pytest.approx(0.5, abs=0.01)
    assert figures["paper"]["prior_rmse_gsd"] == pytest.approx(0.25, abs=0.01)
    assert figures["refined"]["sigma_2"] == 1 and figures["refined"]["confidence"] == "high"
    assert figures["paper, Eq 16"] == {"exit code": 1, "message": "no light"}
    tables = (tmp_path / "out/tables.md").read_text()
    assert "| rendered | 0.25 → 0.5 |" in tables and "| rendered | exit code 1: no light |" in tables
    assert tables.splitlines()[4].endswith("| 1.000 | 8 |"), "the sum over the steps: 2 s, and 6 s for five words"
    command += ["-o", tmp_path / "some", "--program", program, "--runs", "paper", "--set", "a.b=c"]
    some = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert some.returncode == 0, some.stderr
    (figures,) = json.loads((tmp_path / "some/figures.json").read_text()).values()
    assert list(figures) == ["paper"] and figures["paper"]["processor_seconds"] == 12


def test_examples_are_scored_by_their_true_depth(tmp_path: Path) -> None:
    """Their truth is a depth map instead of the renderer's files, so that anybody can reproduce those figures."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    truth = np.where((u > 2) & (v > 2), 600 + 0.1 * u, np.nan).astype(np.float32)
    scene, work = tmp_path / "scene", tmp_path / "work"
    for name in ("scene/truth", "work/fused", "work/prior"):
        (tmp_path / name).mkdir(parents=True)
    tifffile.imwrite(scene / "truth/depth.tif", truth)
    tifffile.imwrite(work / "fused/depth.tif", np.nan_to_num(truth, nan=700))
    tifffile.imwrite(work / "prior/depth.tif", truth + np.where(u > WIDTH / 2, GSD, -GSD).astype(np.float32))
    (work / "fused/camera.txt").write_text(f"1 PINHOLE {WIDTH} {HEIGHT} {FOCAL} {FOCAL} 30 25\n")
    (work / "quality.json").write_text(
        json.dumps({"gsd": GSD, "patches": [{"name": "label", "box": [20, 20, 40, 40]}]})
    )
    command = [sys.executable, ROOT / "benchmarks/rendered/score.py", scene, work, "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    figures = json.loads(done.stdout)
    assert figures["coverage"] == 1 and figures["rmse_gsd"] == 0 and figures["patch_label"] < 1e-3
    assert figures["prior_rmse_gsd"] == pytest.approx(1, abs=0.5) and figures["prior_normal_median_deg"] < 0.01


def test_parts_of_the_refinement_are_left_out_one_at_a_time(station: Path, tmp_path: Path) -> None:
    truth = dict(np.load(station / "gt/depth_normal_mask.npz"))
    np.savez(station / "gt/depth_normal_mask.npz", **truth, mask=np.ones((HEIGHT, WIDTH), bool))
    program = tmp_path / "program"
    text = _PROGRAM.format(python=sys.executable, gsd=GSD)
    program.write_text(text.replace('"optimize.enabled=false" in', '"refine.lobe=false" in'))
    program.chmod(0o755)
    command = [sys.executable, ROOT / "benchmarks/rendered/run.py", "-o", tmp_path / "out", "--data", tmp_path]
    done = subprocess.run([*command, "--program", program, "--ablation"], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    rows = (tmp_path / "out/tables.md").read_text().splitlines()
    assert re.fullmatch(r"\| nothing \| [\d.]+ / [\d.]+ / [\d.]+ \|", rows[2])
    assert rows[3] == "| highlight (`refine.lobe=false`) | exit code 1 |"
    assert rows[4] == "| mirrored surroundings (`refine.environment=false`) | – |", "the same figures to the digit"


def test_photos_at_camera_scale_show_what_the_station_sees() -> None:
    camera_scale: Any = importlib.import_module("camera_scale")
    scene = camera_scale.synthetic.relief(240, 160)
    radiance = np.concatenate([s0 for _, s0, _, _ in camera_scale.synthetic.stokes(scene)]).astype(np.float32)
    radiance *= 0.9 / radiance.max()
    depth = scene.depth.astype(np.float32)
    # A photo from the station's own pose is the station's image. From another pose, each point appears where that camera projects it.
    same = camera_scale.photograph(depth, radiance, scene.camera, scene.camera)
    assert np.abs(same[5:-5, 5:-5, 0] - 255 * radiance[5:-5, 5:-5] ** (1 / 2.2)).mean() < 2
    aside = camera_scale.photo_camera(scene.camera, float(np.median(depth)), (240, 160), 1, 12)
    picture = camera_scale.photograph(depth, radiance, scene.camera, aside)
    fx, fy, cx, cy = scene.camera.params
    v, u = np.mgrid[40:120:3, 60:180:3]
    rays = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones(u.shape)], -1)
    points = (depth[v, u][..., None] * rays) @ aside.rotation.T + aside.translation
    x, y = (
        np.rint(aside.params[0] * points[..., axis] / points[..., 2] + aside.params[2 + axis]).astype(int)
        for axis in (0, 1)
    )
    seen = (picture[y, x, 0] / 255.0) ** 2.2
    assert np.corrcoef(seen.ravel(), radiance[v, u].ravel())[0, 1] > 0.8
    assert np.corrcoef(seen.ravel(), radiance[v, u + 7].ravel())[0, 1] < 0.6


def test_polarizer_benchmark_reads_only_figures_that_a_run_writes(finished_grid: Path) -> None:
    """The benchmark once failed after the run because a figure had been renamed."""
    program = (ROOT / "benchmarks" / "polarizer.py").read_text(encoding="utf-8")
    read = set(re.findall(r"(?:plain|found)\[[\"'](\w+)[\"']\]", program))
    manifest = json.loads((finished_grid / "manifest.json").read_text(encoding="utf-8"))
    assert len(read) > 5 and read <= manifest["steps"]["polarizer"]["notes"]["calibration"].keys()
