"""A station made in Python takes the same keys as a station file and gives the same results."""

from __future__ import annotations

import copy
import dataclasses
import json
import pickle
import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np
import pytest
import tifffile
from PIL import Image

import malus
from conftest import cloud_of
from malus import _core
from malus import station as tables
from malus.photo_steps import inputs_of_fusion
from malus.photogrammetry.control import require_control_points

ROOT = Path(__file__).parents[2]
ANGLES = [0.0, 60.0, 120.0]
SIZE = (40, 60)
CAMERA = malus.Camera("PINHOLE", SIZE[1], SIZE[0], [200.0, 200.0, 29.5, 19.5])

#: Values of both the arrays' station and the file below. The file has the camera's parameters in COLMAP's pixel convention.
WORDS: dict[str, Any] = {
    "polarized": {
        "angle_direction": "cw",
        "angle_zero_deg": 10.0,
        "exposure_s": [0.01, 0.02] * 3,
        "channel_weights": [1.0, 2.0, 1.0],
        "response": "srgb",
        "white_level": 255,
        "black_level": 2,
    },
    "optics": {"light": [0.1, 0.2, -1.0]},
    "patches": [{"name": "label", "box": [3, 4, 20, 21]}],
    "profiles": [{"from": [3, 4], "to": [20, 4.5]}],
    "object": {"title": "Relief", "license": "CC-BY-4.0"},
}

FILE = """
[station]
name = "words"
unit = "cm"

[polarized]
images = ["0.tif", "1.tif", "2.tif", "3.tif", "4.tif", "5.tif"]
angles_deg = [0, 0, 60, 60, 120, 120]
angle_direction = "cw"
angle_zero_deg = 10
exposure_s = [0.01, 0.02, 0.01, 0.02, 0.01, 0.02]
channel_weights = [1, 2, 1]
response = "srgb"
white_level = 255
black_level = 2
frames_averaged = 4

[optics]
refractive_index = 1.6
reflection = "diffuse"
light = [0.1, 0.2, -1]
metal = "none"

[camera]
model = "PINHOLE"
width = 60
height = 40
params = [200, 200, 30, 20]
qvec = [1, 0, 0, 0]
tvec = [0, 0, 0]

[[patch]]
name = "label"
box = [3, 4, 20, 21]

[[profile]]
from = [3, 4]
to = [20, 4.5]

[object]
title = "Relief"
license = "CC-BY-4.0"
"""


@pytest.fixture
def pictures() -> list[np.ndarray]:
    """Color pictures of 8 bits, two exposures at each angle."""
    random = np.random.default_rng(4)
    scene = random.uniform(40, 90, (*SIZE, 3))
    return [
        np.rint(exposure * scene * (1 + 0.2 * np.cos(2 * np.radians(angle)))).astype(np.uint8)
        for angle in ANGLES
        for exposure in (1, 2)
    ]


def in_memory(pictures: list[np.ndarray], **changes: Any) -> malus.Station:
    values: dict[str, Any] = {
        "name": "words", "unit": "cm", "refractive_index": 1.6, "reflection": "diffuse", "metal": "none",
        "frames_averaged": 4, **WORDS, **changes,
    }  # fmt: skip
    return malus.Station(pictures, np.repeat(ANGLES, 2), CAMERA, **values)


@pytest.mark.parametrize("kind", [np.uint8, np.float32])
def test_a_station_of_arrays_equals_that_of_a_file(pictures: list[np.ndarray], tmp_path: Path, kind: type) -> None:
    pictures = [picture.astype(kind) for picture in pictures]
    for k, picture in enumerate(pictures):
        tifffile.imwrite(tmp_path / f"{k}.tif", picture, photometric="rgb")
    (tmp_path / "station.toml").write_text(FILE)
    of_file, of_arrays = malus.Station.load(tmp_path / "station.toml"), in_memory(pictures)
    described = of_file.describe()
    for key in ("path", "files", "images"):
        del described[key]
    assert of_arrays.describe().items() >= described.items()
    assert described["patches"] == [{"name": "label", "box": [3, 4, 20, 21]}]
    options = malus.Options(capture={"registration": "off"})
    works = [tmp_path / "of_file", tmp_path / "of_arrays"]
    expected, found = (
        malus.reconstruct(station, options, until="polarization", threads=1, workspace=work)
        for station, work in zip((of_file, of_arrays), works, strict=True)
    )
    for name in ("unpolarized", "degree", "phase_rad"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    assert np.isfinite(found.unpolarized).mean() > 0.9
    # The numbers of 8 bits are rounded, whether they come from a file or not.
    noises = [malus.Workspace(work).manifest["steps"]["polarization"]["notes"]["noise"] for work in works]
    assert noises[0] == noises[1] and (noises[0]["quantization"] > 0) == (kind is np.uint8)


def test_texture_of_moved_images_is_not_taken_for_polarization() -> None:
    """Interpolation changes fine texture differently in each image, by where the image lies between the pixels."""
    random = np.random.default_rng(1)
    side, angles = 128, [0.0, 30.0, 60.0, 90.0, 120.0, 150.0]
    fv, fu = np.meshgrid(np.fft.fftfreq(side), np.fft.fftfreq(side), indexing="ij")
    texture = np.fft.fft2(random.standard_normal((side, side))) * np.exp(-3 * (fu**2 + fv**2))
    images = []
    for k in range(len(angles)):
        du, dv = random.uniform(-0.7, 0.7, 2) if k else (0, 0)
        moved = np.fft.ifft2(texture * np.exp(-2j * np.pi * (fu * du + fv * dv))).real
        images.append(np.clip(0.35 + 0.13 * moved, 0.02, 0.95).astype(np.float32))
    camera = malus.Camera("PINHOLE", side, side, [200.0, 200.0, 63.5, 63.5])
    station = malus.Station(images, angles, camera, polarized={"full_well_e": 20000, "read_noise_e": 8})
    found = malus.reconstruct(station, until="polarization")
    assert found.degree is not None and np.nanmedian(found.degree[10:-10, 10:-10]) < 0.022  # .030 without smoothing


def test_a_response_table_of_other_numbers_than_the_arrays_is_refused(
    pictures: list[np.ndarray], tmp_path: Path
) -> None:
    """Images in [0, 1] were looked up among the first numbers of a table of DN, and so were black, without a word."""
    curve = tmp_path / "curve.txt"
    curve.write_text("0 0\n255 1\n")
    options = malus.Options(capture={"registration": "off"})
    shares = [picture / 255 for picture in pictures[::2]]
    with pytest.raises(malus.InputError, match=r"images\[0\]: the response table is of numbers up to 255"):
        station = malus.Station(shares, ANGLES, CAMERA, polarized={"response": str(curve)})
        malus.reconstruct(station, options, until="polarization")
    curve.write_text("0 0\n1 1\n")
    found = malus.reconstruct(station, options, until="polarization")
    assert found.unpolarized is not None and np.nanmedian(found.unpolarized) == pytest.approx(65 / 255, rel=0.2)


def test_a_station_of_a_file_can_be_sent_to_another_process(
    small_station: Path, pictures: list[np.ndarray], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(small_station.parent)
    station = malus.Station.load(small_station.name)
    sent = [pickle.dumps(one) for one in (station, station.with_curves_of([(3, 4), (50, 60)]))]
    monkeypatch.chdir(tmp_path)
    expected = malus.Station.load(small_station)
    for one, told in zip(sent, (expected, expected.with_curves_of([(3, 4), (50, 60)])), strict=True):
        assert pickle.loads(one).describe() == told.describe()
    of_arrays = in_memory(pictures)
    assert copy.copy(of_arrays).describe() == of_arrays.describe()
    with pytest.raises(TypeError, match="station words: is made of arrays"):
        pickle.dumps(of_arrays)


def test_priors_given_in_python_equal_that_of_the_station_file(small_station: Path) -> None:
    folder = small_station.parent
    expected = malus.reconstruct(malus.Station.load(small_station), until="prior", threads=1)
    described = malus.Station.load(small_station).describe()
    images = [tifffile.imread(path).astype(np.float32) for path in sorted((folder / "pol").glob("*.tif"))]
    given = described["camera"]
    camera = malus.Camera(
        given["model"], given["width"], given["height"], given["params"], given["rotation"], given["translation"]
    )
    points, normals = _core.read_oriented_points(str(folder / "dense/cloud.ply"))
    cloud: dict[str, Any] = {"prior_points": points, "prior_normals": normals}
    for prior in (cloud, {"prior": {"cloud": str(folder / "dense/cloud.ply")}}):
        station = malus.Station(images, described["angles_deg"], camera, polarized={"white_level": 16383}, **prior)
        found = malus.reconstruct(station, until="prior", threads=1)
        # Equal except for the rounding of the camera's parameters.
        np.testing.assert_allclose(found.prior_depth, expected.prior_depth, rtol=1e-6)
        np.testing.assert_allclose(found.prior_sigma, expected.prior_sigma, rtol=1e-4)


def test_colors_of_a_prior_given_in_python_are_compared_with_the_images(tiny_station: Path, tmp_path: Path) -> None:
    of_file, cloud = malus.Station.load(tiny_station), cloud_of(tiny_station)
    described = of_file.describe()
    given = described["camera"]
    camera = malus.Camera(
        given["model"], given["width"], given["height"], given["params"], given["rotation"], given["translation"]
    )
    images = [tifffile.imread(path) for path in sorted((tiny_station.parent / "pol").glob("*.tif"))]

    def run(station: malus.Station, work: Path) -> tuple[str, dict[str, dict[str, Any]]]:
        """Key of the checks, and what they find."""
        malus.reconstruct(station, until="evidence", threads=1, workspace=work)
        workspace = malus.Workspace(work)
        findings = {finding["check"]: finding for finding in workspace.findings}
        return workspace.manifest["steps"]["evidence"]["key"], findings

    def of_arrays(colors: np.ndarray | None) -> tuple[str, dict[str, dict[str, Any]]]:
        station = malus.Station(
            images, described["angles_deg"], camera, polarized={"white_level": 16383}, frames_averaged=16,
            full_well_e=20000, read_noise_e=8, prior_points=cloud["xyz"], prior_normals=cloud["normal"], prior_colors=colors,
        )  # fmt: skip
        return run(station, tmp_path / "work")

    _, expected = run(of_file, tmp_path / "of_file")
    key, found = of_arrays(cloud["color"])
    for check in ("prior", "contrast"):
        assert found[check]["message"] == expected[check]["message"]
        assert found[check]["figures"] == pytest.approx(expected[check]["figures"], rel=1e-3, abs=1e-6)
    changed = cloud["color"].copy()
    changed[::2] //= 2
    (darker_key, darker), (bare_key, bare) = of_arrays(changed), of_arrays(None)
    assert len({key, darker_key, bare_key}) == 3
    assert darker["prior"]["figures"]["color_as_given"] < found["prior"]["figures"]["color_as_given"]
    assert "color_as_given" not in bare["prior"]["figures"]
    assert of_arrays(cloud["color"].astype(float))[0] == key


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"polarized": {"respons": "srgb"}}, r"\[polarized\].respons.*response"),
        (
            {"polarized": {"exposure_s": [0.01, 0.02, 0.01, 0.03, 0.01, 0.02]}},
            r"exposure_s: differs between 0° and 60°",
        ),
        ({"polarized": {"images": ["a.png"]}}, r"\[polarized\].images"),
        ({"optics": {"light": [0, 0, 1]}}, r"\[optics\].light.*expected a direction"),
        ({"reflection": "matte"}, r"\[optics\].reflection.*file of a label image"),
        ({"metal": "bronz"}, r"\[optics\].metal = .bronz., expected .*\"bronze\""),
        ({"metal": [0.7, 0.0]}, r"\[optics\].metal.*k from 0.5 to 20"),
        ({"metal": "bronze"}, r"\[optics\].metal.*reflection = \"diffuse\""),
        ({"metal": (0.7, 2.6), "reflection": np.ones(SIZE)}, r"\[optics\].metal.*labels of the reflection"),
        ({"patches": [{"box": [0, 0, 60, 3]}]}, r"\[\[patch\]\] 1.box.*60 x 40"),
        ({"profiles": [{"from": [0, 0]}]}, r"\[\[profile\]\] 1.to"),
        ({"scale": [{"distance": 3}]}, r"needs \[photos\]"),
        ({"control": [{"xyz": [0, 0, 100]}]}, r"\[\[control\]\] 1.pixel: is missing"),
        ({"control": [{"xyz": [0, 0, 100], "pixel": [60, 0]}]}, r"point 1 has pixel = \[60, 0\].*60 x 40"),
        ({"object": {"tittle": "x"}}, r"\[object\].tittle"),
        ({"prior": {"cloud": "no.ply"}}, r"no\.ply"),
        ({"prior": {"sphere": {"center": [0, 0, 9], "radius": 3}}}, r"\[prior\].sigma.*is missing.*from the sphere"),
        ({"prior_points": np.zeros((3, 3)), "prior_sigma": 0.0}, r"\[prior\].sigma = 0"),
        ({"prior_sigma": 1.0}, "0 surfaces"),
        ({"prior_sigma": float("inf")}, r"station: \[prior\].sigma = inf, expected a finite number"),
        ({"patches": [{"box": [0, float("nan"), 3, 3]}]}, r"station: \[patch\]\[0\].box\[1\] = nan"),
        ({"optics": {"light": np.array([0, np.nan, -1])}}, r"\[optics\].light\[1\] = nan"),
        ({"object": {"date": float("nan")}}, r"\[object\].date = nan"),
        ({"patches": [{"box": [0, None, 3, 3]}]}, r"\[patch\]\[0\].box\[1\] is null, expected a value"),
        ({"polarized": {"curve_pixels": [[60, 0]]}}, r"curve_pixels \[60, 0\].*60 x 40"),
    ],
)
def test_mistakes_are_named_as_in_a_file(pictures: list[np.ndarray], changes: dict[str, Any], message: str) -> None:
    with pytest.raises(malus.InputError, match=message):
        in_memory(pictures, **changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"prior_normals": np.zeros((3, 3))}, "without prior_points"),
        ({"prior_points": np.zeros((3, 3)), "prior_normals": np.zeros((2, 3))}, r"prior_normals has shape \(2, 3\)"),
        ({"prior_colors": np.zeros((3, 3))}, "prior_colors are given without prior_points"),
        ({"prior_points": np.zeros((3, 3)), "prior_colors": np.zeros((2, 3))}, r"prior_colors has shape \(2, 3\)"),
        ({"prior_points": np.zeros((3, 3)), "prior_colors": np.full((3, 3), 0.5)}, "prior_colors has values from 0.5"),
        ({"prior_points": np.zeros((3, 3)), "prior": {"mesh": "x.ply"}}, "more than one is given"),
        ({"prior_mesh": (np.zeros((3, 3)), [[0, 1, 3]])}, r"prior_mesh\[1\] has indices from 0 to 3, expected 0 to 2"),
        ({"prior_mesh": np.zeros((4, 3, 3))}, "prior_mesh has 4 parts, expected vertices"),
        ({"prior_points": np.ma.masked_equal(np.eye(3), 1)}, "prior_points has masked values"),
        ({"reflection": np.ones((3, 3))}, r"reflection has shape \(3, 3\), expected \(40, 60\)"),
        ({"reflection": np.full(SIZE, 3)}, r"reflection has the value 3, expected 0 \(decide\)"),
        ({"reflection": np.ones(SIZE), "optics": {"reflection": "auto"}}, "optics: has reflection, which an argument"),
        ({"optics": {"reflection": "auto"}}, "optics: has reflection, which an argument"),
        ({"metal": (0.7, 2.6), "optics": {"metal": "none"}}, "optics: has metal, which an argument"),
        ({"refractive_index": None, "optics": {"refractive_index": 1.4}}, "optics: has refractive_index, which an"),
        ({"polarized": {"frames_averaged": 4}}, "polarized: has frames_averaged, which an argument"),
        ({"read_noise_e": 3.0, "polarized": {"read_noise_e": None}}, "polarized: has read_noise_e, which an argument"),
        ({"polarized": {"angles_deg": "auto"}}, "polarized: has angles_deg, which an argument"),
        ({"prior_sigma": 2.0, "prior": {"cloud": "a.ply", "sigma": 1.0}}, "prior: has sigma, which an argument"),
    ],
)
def test_contradictory_arguments_are_refused(pictures: list[np.ndarray], changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        in_memory(pictures, **changes)


def test_tables_may_state_what_no_argument_states(pictures: list[np.ndarray]) -> None:
    stated: dict[str, Any] = {
        "polarized": {"white_level": 255, "frames_averaged": 4},
        "optics": {"refractive_index": 1.4, "metal": "none"},
    }
    described = malus.Station(pictures, np.repeat(ANGLES, 2), CAMERA, **stated).describe()
    assert [described[key] for key in ("frames_averaged", "refractive_index", "metal")] == [4, 1.4, "none"]


def test_priors_given_as_a_shape_and_with_a_standard_deviation(pictures: list[np.ndarray]) -> None:
    plane: dict[str, Any] = {"point": [0, 0, 200], "normal": [0, 0, 1]}
    depth = np.full((40, 60), 200.0)
    corners = np.array([[-90, -90, 200], [90, -90, 200], [90, 90, 200], [-90, 90, 200]])
    priors: dict[str, dict[str, Any]] = {
        "plane": {"prior": {"plane": plane, "sigma": 0.5}},
        "depth": {"prior_depth": depth, "prior_sigma": 0.5},
        "mesh": {"prior_mesh": (corners, [[0, 2, 1], [0, 3, 2]]), "prior_sigma": 0.5},
    }
    for kind, prior in priors.items():
        station = in_memory(pictures, **prior)
        described = station.describe()
        assert (described["prior"], described["prior_sigma"]) == (kind, 0.5)
        assert described.get("prior_plane") == (plane if kind == "plane" else None)
        found = malus.reconstruct(station, malus.Options(capture={"registration": "off"}), until="prior", threads=1)
        np.testing.assert_allclose(found.prior_depth, depth, rtol=1e-6)
        np.testing.assert_allclose(found.prior_sigma, 0.5)


def test_known_distances_scale_a_prior_in_memory(pictures: list[np.ndarray]) -> None:
    bar = {"distance": 5.0, "a_xyz": [0, 0, 0], "b_xyz": np.array([0, 2.5, 0])}
    rows, columns = np.mgrid[0:40:0.5, 0:60:0.5]
    points = np.stack([(columns.ravel() - 29.5) / 200, (rows.ravel() - 19.5) / 200, np.ones(rows.size)], -1) * 100
    points += np.random.default_rng(5).normal(0, 0.1, points.shape)
    station = in_memory(pictures, prior_points=points, scale=[bar])
    found = malus.reconstruct(station, malus.Options(capture={"registration": "off"}), until="prior", threads=1)
    assert np.nanmedian(found.prior_depth) == pytest.approx(200, rel=1e-3)


def test_whatever_changes_the_fused_surface_repeats_the_second_sweep(pictures: list[np.ndarray]) -> None:
    zeros = {name: np.zeros(SIZE, np.float32) for name in ("unpolarized", "degree", "phase_rad")}

    def inputs(maps: Any = zeros, options: malus.Options | None = None, **changes: Any) -> dict[str, Any]:
        description = in_memory(pictures, **changes).describe()
        return inputs_of_fusion(description, maps, options or malus.Options())

    before = inputs()
    assert before == inputs(name="another", options=malus.Options(assess={"polarization_height": False}))
    changed = [
        inputs(frames_averaged=9),
        inputs(full_well_e=9000.0),
        inputs(read_noise_e=3.0),
        inputs(refractive_index=1.4),
        inputs(reflection="specular"),
        inputs(reflection=np.ones(SIZE, np.uint8)),
        inputs(reflection=np.zeros(SIZE, np.uint8)),
        inputs(optics={"light": [0.3, 0.2, -1.0]}),
        inputs(metal="auto"),
        inputs(maps={**zeros, "degree": np.ones(SIZE, np.float32)}),
        inputs(options=malus.Options(refine={"prior_weight": 2.0})),
    ]
    assert all(changed.count(one) == 1 for one in changed)
    assert before not in changed


def test_photos_give_camera_and_prior_of_a_station_in_memory(
    pictures: list[np.ndarray], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only a station of a file could have photos and control points."""
    (tmp_path / "views").mkdir()
    for name in ("a.png", "b.png"):
        Image.fromarray(pictures[0]).save(tmp_path / "views" / name)
    depth = np.full(SIZE, 200, np.float32)
    described: list[dict[str, Any]] = []

    def find(description: dict[str, Any], *_: object, **__: object) -> SimpleNamespace:
        described.append(description)
        camera = dataclasses.replace(CAMERA, translation=[0.0, 0.0, 50.0])
        return SimpleNamespace(station=camera, figures={}, times={}, warnings=["few photos"])

    def sweep(*_: object, **__: object) -> malus.photogrammetry.Swept:
        return malus.photogrammetry.Swept(depth, np.full_like(depth, 0.5), None, {}, {})

    monkeypatch.setattr(malus.photogrammetry, "find_cameras", find)
    monkeypatch.setattr(malus.photogrammetry, "sweep_station", sweep)
    marks = [{"image": "a.png", "x": 1, "y": 2.5}, {"image": "b.png", "x": 3, "y": 4}]
    point = {"name": "A", "xyz": [1, 2, 3], "marks": marks, "pixel": [4, 5]}
    station = in_memory(pictures, photos={"folder": "views"}, control=[point])
    found = malus.reconstruct(station, malus.Options(capture={"registration": "off"}), until="prior", threads=1)
    np.testing.assert_allclose(found.prior_depth, depth, rtol=1e-3)
    assert found.camera is not None and found.camera.pose()[1][2] == 50
    unplaced = malus.reconstruct(
        station, malus.Options(capture={"registration": "off"}), until="polarization", threads=1
    )
    assert unplaced.camera is None and unplaced.pose is None, "it had the pose of the world frame"
    assert "photos: few photos" in found.warnings
    assert described[0]["photos"]["folder"] == str(tmp_path / "views") and described[0]["path"] == "station words"
    with pytest.raises(malus.InputError, match=r"^station words: \[\[control\]\]: 1 point without check"):
        require_control_points(station.describe(), ["a.png", "b.png"])
    assert described[0]["control"][0]["marks"][1] == {"image": "b.png", "x": 3, "y": 4}

    scaled = in_memory(pictures, photos={"folder": "views"}, scale=[{"distance": 3, "a": marks, "b": marks}])
    assert scaled.describe()["scale"][0]["a"][0]["y"] == 2.5
    with pytest.raises(malus.InputError, match=r"\[photos\].folder.*expected an existing folder"):
        in_memory(pictures, photos={"folder": "none"})


def test_curve_pixels_of_a_station_in_memory(pictures: list[np.ndarray]) -> None:
    station = in_memory(pictures).with_curves_of([(59, 39)])
    assert station.describe()["curve_pixels"] == [[59, 39]]
    with pytest.raises(malus.InputError, match=r"pixel \[60, 0\].*60 x 40"):
        station.with_curves_of([(60, 0)])


def test_digital_numbers_without_their_white_level_are_refused(pictures: list[np.ndarray]) -> None:
    """They were saturated, and with a dark background the run went on without polarization on the object."""
    without = {key: value for key, value in WORDS["polarized"].items() if key not in ("white_level", "black_level")}
    with pytest.raises(ValueError, match=r"images\[0\] reaches \d+, expected linear .* or their polarized.white_level"):
        in_memory(pictures, polarized=without)
    in_memory([picture / np.float32(255) for picture in pictures], polarized=without)


def test_labels_are_of_the_image_as_taken(pictures: list[np.ndarray], tmp_path: Path) -> None:
    labels = np.full(SIZE, 2, np.uint8)
    labels[:, :10] = 1
    Image.fromarray(labels).save(tmp_path / "labels.png")
    camera = malus.Camera("SIMPLE_RADIAL", SIZE[1], SIZE[0], [40.0, 29.5, 19.5, -0.3])
    options = malus.Options(capture={"registration": "off"})
    for k, reflection in enumerate((str(tmp_path / "labels.png"), labels)):
        station = malus.Station(pictures, np.repeat(ANGLES, 2), camera, **WORDS, reflection=reflection)
        malus.reconstruct(station, options, until="zenith", workspace=tmp_path / f"w{k}")
        found = np.asarray(Image.open(tmp_path / f"w{k}/polarization/label.png"))
        # Column 7 of the undistorted view shows column 9.1 of the image, column 8 shows 9.9.
        assert list(found[20, 6:10]) == [1, 1, 2, 2]


def test_control_points_check_the_camera_of_a_station_in_memory(pictures: list[np.ndarray]) -> None:
    points: list[Any] = [
        {"name": "A", "xyz": [0, 0, 100], "pixel": [29.5, 19.5]},
        {"xyz": np.array([10, 0, 100]), "pixel": (54.5, 19.5), "check": True},
    ]
    station = in_memory(pictures, control=points)
    image = station.describe()["control_image"]
    assert image["use"] == "check"
    assert [(point["name"], round(point["du_px"], 6)) for point in image["points"]] == [("A", 0), ("2", 5)]
    warnings = malus.check(station, threads=1)["warnings"]
    assert any("[[control]] 2: its mark lies 5" in warning for warning in warnings)


def test_polarization_needs_no_camera(pictures: list[np.ndarray]) -> None:
    def station(camera: malus.Camera | None, **changes: Any) -> malus.Station:
        return malus.Station(pictures, np.repeat(ANGLES, 2), camera, **{**WORDS, **changes})

    options = malus.Options(capture={"registration": "off"})
    found, expected = (
        malus.reconstruct(station(camera), options, until="polarization", threads=1) for camera in (None, CAMERA)
    )
    np.testing.assert_array_equal(found.degree, expected.degree)
    assert found.camera is None and expected.camera == CAMERA
    with pytest.raises(malus.InputError, match=r"station: camera: is missing, expected \[camera\]"):
        station(None, prior_depth=np.ones(SIZE))
    with pytest.raises(malus.InputError, match=r"\[\[patch\]\] 1.box.*60 x 40"):
        station(None, patches=[{"box": [0, 0, 60, 3]}])
    with pytest.raises(malus.InputError, match=r"^station station: \[prior\] is missing"):
        malus.reconstruct(station(CAMERA), options, threads=1)


def test_angles_in_radians_are_refused(pictures: list[np.ndarray]) -> None:
    with pytest.raises(malus.InputError, match="angles_deg: all angles lie within 6.3°.*radians"):
        malus.Station(pictures, np.radians(np.repeat(ANGLES, 2)), CAMERA, **WORDS)


def test_a_file_that_is_called_as_a_response_is_no_table(
    pictures: list[np.ndarray], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The key of the step depended on the current folder, and an archive took the file."""
    keys = []
    for folder in ("empty", "full"):
        (tmp_path / folder).mkdir()
        monkeypatch.chdir(tmp_path / folder)
        if folder == "full":
            Path("srgb").write_text("0 0\n255 1\n")
        station = in_memory(pictures)
        assert station.describe()["response"] == "srgb" and station.describe()["files"] == []
        options = malus.Options(capture={"registration": "off"})
        malus.reconstruct(station, options, until="polarization", threads=1, workspace=tmp_path / folder / "work")
        keys.append(malus.Workspace(tmp_path / folder / "work").manifest["steps"]["polarization"]["key"])
    assert keys[0] == keys[1]


def test_a_camera_is_that_of_its_description(pictures: list[np.ndarray]) -> None:
    turned = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    camera = malus.Camera("SIMPLE_RADIAL", SIZE[1], SIZE[0], (40, 29.5, 19.5, -0.3), turned, np.arange(3))
    said = json.loads(json.dumps(camera.description()))
    assert malus.Camera.from_description(said) == camera
    assert in_memory(pictures).describe()["camera"] == CAMERA.description()
    del said["rotation"], said["translation"]
    assert malus.Camera.from_description(said) == malus.Camera(camera.model, camera.width, camera.height, camera.params)


def test_a_metal_is_stated_by_name_or_index(pictures: list[np.ndarray]) -> None:
    assert in_memory(pictures, reflection="auto", metal="bronze").describe()["metal"] == "bronze"
    for index in (np.array([0.7, 2.6]), 0.7 + 2.6j, np.complex128(0.7, 2.6)):
        assert in_memory(pictures, reflection="auto", metal=index).describe()["metal"] == "0.7+2.6i"


def names_expected(make: Callable[[], object]) -> list[str]:
    """The words in quotes that the program expects in place of a "?"."""
    with pytest.raises(malus.InputError, match=r"= '\?', expected") as refused:
        make()
    return re.findall(r'"([\w:]+)"', str(refused.value).split(", expected")[1])


def listed_in(page: str, begin: str, end: str) -> list[str]:
    """Names in quotes between two texts of Studio's page."""
    return re.findall(r"'(\w+)'", page.split(begin)[1].split(end)[0])


def test_words_of_page_and_documentation_are_those_of_the_program(pictures: list[np.ndarray]) -> None:
    page = (ROOT / "python/malus/studio/static/station.js").read_text(encoding="utf-8")
    documented = (ROOT / "docs/station-file.md").read_text(encoding="utf-8")
    metals = names_expected(lambda: in_memory(pictures, metal="?"))[2:]  # after "auto" and "none"
    assert listed_in(page.split("function metalChoice")[1], "names = [", "]") == metals
    table = documented.split("| metal |")[1].split("\n\n")[0]
    assert re.findall(r"^\| (\w+) \| [\d.]+ \+ [\d.]+ i \|", table, re.MULTILINE) == metals
    catalog = page.split("CATALOG = [")[1].split("]];")[0]
    assert re.findall(r"\['(\w+)', ", f"[{catalog}") == list(in_memory(pictures).describe()["object"])
    units = names_expected(lambda: in_memory(pictures, unit="?"))
    assert sorted(listed_in(page, "'unit') ?? 'mm', [", "]")) == sorted(units)
    lengths = (ROOT / "python/malus/studio/static/api.js").read_text(encoding="utf-8").split("METERS = {")[1]
    assert re.findall(r"(\w+): ", lengths.split("}")[0]) == units
    reflections = page.split("'Reflection', under('optics', 'reflection') ?? 'auto', [")[1].split("]]")[0]
    words = names_expected(lambda: in_memory(pictures, reflection="?"))
    assert sorted(re.findall(r"\['(\w+)', ", reflections)) == sorted(words)


def test_literals_of_types_are_the_names_of_the_program(pictures: list[np.ndarray]) -> None:
    mosaic, cell = [np.ones((8, 8))], [[90, 45], [135, 0]]
    makers: dict[str, Callable[[], object]] = {
        "angle_direction": lambda: in_memory(pictures, polarized={"angle_direction": "?"}),
        "channel": lambda: in_memory(pictures, polarized={"channel": "?"}),
        "mosaic_colors": lambda: malus.Station(mosaic, None, None, polarized={"mosaic": cell, "mosaic_colors": "?"}),
    }
    types = get_type_hints(tables.PolarizedValues)
    words = {key: list(get_args(allowed)) for key, allowed in types.items() if get_origin(allowed) is Literal}
    assert words == {key: names_expected(make) for key, make in makers.items()}


def keys_in(source: str, lists: str) -> set[str]:
    """Keys that a source of the parser lists, for tables that have no type in Python."""
    text = (ROOT / "cpp/malus/io" / source).read_text(encoding="utf-8")
    return set(re.findall(r'"(\w+)"', " ".join(re.findall(lists, text))))


def test_types_of_tables_have_the_keys_of_the_station_file(pictures: list[np.ndarray]) -> None:
    """Keys of docs/station-file.md, which are those of the parser; those that name image files are for station files only."""
    text = (ROOT / "docs/station-file.md").read_text(encoding="utf-8")
    of_files = {"images", "angles_deg", "angle_pattern", "mask"}
    expected = {
        "[station]": keys_in("station_file.cpp", r'section\("station", \{(.*?)\}'),
        "[camera]": keys_in("camera_section.cpp", r"Keys \w+(?:\{| = joined\(\{\{)(.*?)\}"),
        "[object]": set(in_memory(pictures).describe()["object"]),
        "[polarized]": set(tables.PolarizedValues.__annotations__) | of_files,
        "[optics]": set(tables.OpticsValues.__annotations__),
        "[prior]": set(tables.PriorValues.__annotations__),
        "[photos]": set(tables.PhotosValues.__annotations__),
        "[[scale]]": set(tables.ScaleValues.__annotations__),
        "[[control]]": set(tables.ControlValues.__annotations__),
        "[[patch]]": set(tables.PatchValues.__annotations__),
        "[[profile]]": set(tables.ProfileValues.__annotations__),
    }
    sections = {part.split()[0]: part for part in text.split("\n## ")[1:]}
    for name, keys in expected.items():
        rows = re.findall(r"^\| ((?:`\w+`(?:, )?)+) \|", sections[name], re.MULTILINE)
        assert {key for row in rows for key in re.findall(r"\w+", row)} == keys, name
    # Tables within a line, such as those of shapes and marks.
    for typed in (tables.PlaneValues, tables.SphereValues, tables.CylinderValues, tables.MarkValues):
        assert all(re.search(rf"[{{,] {key} = ", text) for key in typed.__annotations__), typed
