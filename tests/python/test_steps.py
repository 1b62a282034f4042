"""Each step alone on arrays, compared with the truth; and docs/steps.md: every name in it exists, and every step is tested."""

from __future__ import annotations

import importlib
import inspect
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import malus
from conftest import ROOT, malus_here
from malus import synthetic
from malus.camera import Camera

ROWS = [
    [cell.strip() for cell in line.strip("| \n").split("|")]
    for line in (ROOT / "docs" / "steps.md").read_text(encoding="utf-8").splitlines()
    if line.startswith("| ") and not line.startswith("| step")
]


def of_python(cell: str) -> list[str]:
    """Full names of the functions in a cell: names without a module are of the first name's module."""
    names = re.findall(r"`([\w.]+)`", cell)
    module = names[0].rpartition(".")[0] if names else ""
    return [name if "." in name else f"{module}.{name}" for name in names]


#: Direction to the lamp, so far to the side that nothing mirrors the lamp.
LAMP = (-0.6, -0.6, -0.53)
ANGLES = np.radians([0, 30, 60, 90, 120, 150])


@dataclass
class Dome:
    """A matte bump with ripples, of one albedo, under one lamp: images without noise, and the truth."""

    scene: synthetic.Scene
    normals: np.ndarray
    images: list[np.ndarray]
    state: malus.polarization.PolarizationState

    @property
    def camera(self) -> Camera:
        return self.scene.camera

    def detail_gsd(self, depth: np.ndarray) -> float:
        """Robust spread of the depth error relative to neighboring pixels, without the borders, in GSD."""
        error = (depth - self.scene.depth)[8:-8, 8:-8] / self.scene.gsd
        error = error - 0.25 * sum(np.roll(error, shift, axis) for axis in (0, 1) for shift in (-3, 3))
        return 1.48 * float(np.nanmedian(np.abs(error[4:-4, 4:-4])))


@pytest.fixture(scope="module")
def dome() -> Dome:
    size, distance, focal = 96, 800.0, 1600.0
    camera = Camera("PINHOLE", size, size, [focal, focal, 47.5, 47.5])
    v, u = np.mgrid[:size, :size].astype(float)
    r2 = ((u - 47.5) ** 2 + (v - 47.5) ** 2) / 48**2
    depth = distance + 4 * r2 + 0.1 * np.sin(u / 2.5) * np.sin(v / 2.5)
    scene = synthetic.Scene(depth, np.full((size, size), 0.6, np.float32), camera)
    matte = synthetic.Reflectance(sky=0.0, roughness=0.01, light=LAMP)
    bands = list(synthetic.stokes(scene, matte))
    s0, s1, s2 = (np.concatenate([band[k] for band in bands]) for k in (1, 2, 3))
    images = [0.5 * (s0 + s1 * np.cos(2 * a) + s2 * np.sin(2 * a)) for a in ANGLES]
    normals = malus.surface.normals_from_depth(depth, camera)
    return Dome(scene, normals, images, malus.polarization.decompose(images, ANGLES))


def test_capture_on_arrays() -> None:
    dn = np.array([[64.0, 500.0, 1023.0]])
    linear = malus.capture.linearize(dn, response="gamma:2.0", black_level=64, white_level=1023)
    np.testing.assert_allclose(linear, ((dn - 64) / 959) ** 2, atol=1e-6)

    mosaic = np.zeros((16, 16))
    for (row, column), value in {(0, 0): 0.1, (0, 1): 0.2, (1, 0): 0.3, (1, 1): 0.4}.items():
        mosaic[row::2, column::2] = value
    for value, image in zip((0.1, 0.2, 0.3, 0.4), malus.capture.demosaic(mosaic), strict=True):
        np.testing.assert_allclose(image, value, atol=1e-6)
    with pytest.raises(ValueError, match='colors = "RGBG" is not known'):
        malus.capture.demosaic(mosaic, colors="RGBG")

    def texture(shift: tuple[float, float]) -> np.ndarray:
        x, y = np.meshgrid(np.arange(160) - shift[0], np.arange(120) - shift[1])
        return 0.5 + 0.2 * (np.sin(x / 3 + np.sin(y / 7)) + np.cos(y / 4 + np.cos(x / 9)))

    found = malus.capture.register([texture((0, 0)), texture((1.25, -0.5))], threads=2)
    middle = np.array([80.0, 60.0, 1.0])
    np.testing.assert_allclose(found[1].image_from_base @ middle, middle[:2] + (1.25, -0.5), atol=0.01)

    lens = Camera("SIMPLE_RADIAL", 64, 48, [60.0, 31.5, 23.5, 0.05])
    v, u = np.mgrid[:48, :64].astype(float)
    # The brightness in the distorted image is the ideal column: after undistortion it equals the pixel's own column.
    measured = np.hypot(u - 31.5, v - 23.5) / 60
    ideal = measured.copy()
    for _ in range(30):
        ideal = measured / (1 + 0.05 * ideal**2)
    column = 31.5 + (u - 31.5) * np.where(measured > 0, ideal / np.maximum(measured, 1e-12), 1)
    flat = malus.capture.undistort(column / 64, lens)
    # Without the lens model the error is 0.5 px.
    np.testing.assert_allclose(flat[4:-4, 4:-4] * 64, u[4:-4, 4:-4], atol=2e-3)


def test_polarization_on_arrays(dome: Dome) -> None:
    wrong = ANGLES + np.radians([0, 2, -1, 1, 0, -2])
    found = malus.polarization.calibrate(dome.images, wrong, full_well_e=1e9, read_noise_e=0)
    turned = found["angles_rad"] - ANGLES
    assert np.abs(np.degrees(turned - turned.mean())).max() < 0.3  # of 2°; the images do not determine the zero
    np.testing.assert_allclose(found["gains"], 1, atol=5e-3)
    counts = [np.rint(65535 * image).astype(np.uint16) for image in dome.images]
    residual = malus.polarization.calibrate(dome.images, wrong)["residual_before"]
    assert malus.polarization.calibrate(counts, wrong)["residual_before"] == pytest.approx(residual, rel=0.1)

    zenith = np.linspace(0.05, 0.9, 20)
    degree = malus.polarization.specular_degree(zenith)
    np.testing.assert_allclose(malus.polarization.specular_zenith(degree), zenith, atol=1e-6)
    beyond = malus.polarization.specular_zenith(degree[-1:], above_brewster=True)
    assert beyond[0] > malus.polarization.brewster_angle()
    np.testing.assert_allclose(malus.polarization.specular_degree(beyond), degree[-1:], atol=1e-6)


def test_priors_on_arrays(dome: Dome) -> None:
    camera, truth = dome.camera, dome.scene.depth
    v, u = np.mgrid[:96, :96].astype(float)
    smooth = 800 + 4 * ((u - 47.5) ** 2 + (v - 47.5) ** 2) / 48**2
    points = np.stack([(u - 47.5) / 1600 * smooth, (v - 47.5) / 1600 * smooth, smooth], -1)
    cloud = malus.prior.project_points(points[::3, ::3].reshape(-1, 3), camera)
    inside = np.s_[4:-4, 4:-4]
    gsd = dome.scene.gsd
    assert np.abs(cloud.depth - smooth)[inside].max() < 0.2 * gsd and (cloud.sigma[inside] > 0).all()

    # Few noisy points: their normals add information about the form between them.
    random = np.random.default_rng(3)
    normals = malus.surface.normals_from_depth(smooth, camera)
    few = np.s_[8:-8:8, 8:-8:8]
    noisy = points[few].reshape(-1, 3) + random.normal(0, gsd, points[few].shape).reshape(-1, 3)
    off = {
        name: np.abs(malus.prior.project_points(noisy, camera, normals=of).depth - smooth)[12:-12, 12:-12].mean()
        for name, of in (("without", None), ("with", normals[few].reshape(-1, 3)))
    }
    assert off["with"] < 0.8 * off["without"], off

    first = (np.arange(95)[:, None] * 96 + np.arange(95)).reshape(-1)
    triangles = np.concatenate(
        [np.stack([first, first + 1, first + 97], -1), np.stack([first, first + 97, first + 96], -1)]
    )
    mesh = malus.prior.project_mesh(points.reshape(-1, 3), triangles, camera)
    assert np.abs(mesh.depth - smooth)[inside].max() < 0.2 * gsd

    holed = truth.copy()
    holed[40:44, 40:44] = np.nan
    depth = malus.prior.project_depth(holed, camera)
    assert np.abs(depth.depth - truth)[inside].max() < 1.5 * gsd


@pytest.fixture(scope="module")
def turned(dome: Dome) -> Camera:
    """The dome's camera elsewhere in the world."""
    rotation = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    camera = dome.camera
    return Camera(camera.model, camera.width, camera.height, camera.params, rotation, [10.0, -20, 30])


def test_priors_of_shapes_on_arrays(turned: Camera) -> None:
    rotation, translation = turned.pose()
    v, u = np.mgrid[:96, :96].astype(float)
    rays = np.stack([(u - turned.cx) / turned.fx, (v - turned.cy) / turned.fy, np.ones_like(u)], -1)

    def world(in_cam: list[float]) -> np.ndarray:
        return (np.array(in_cam) - translation) @ rotation

    def points(prior: malus.prior.DepthPrior) -> np.ndarray:
        return (prior.depth[..., None] * rays - translation) @ rotation

    center, axis = world([1, -2, 900]), np.array([3.0, 1, 0])
    normal = np.array([0, 0.1, -1]) @ rotation
    shapes: dict[str, Any] = {
        "plane": {"point": center, "normal": normal},
        "sphere": {"center": center, "radius": 100},
        "cylinder": {"point": center, "axis": axis, "radius": 100},
    }

    def project(kind: str) -> malus.prior.DepthPrior:
        shape: Any = {kind: shapes[kind]}
        return malus.prior.project_shape(shape, 0.5, turned)

    priors = {kind: project(kind) for kind in shapes}
    off = {kind: points(prior) - center for kind, prior in priors.items()}
    assert np.abs(off["plane"] @ normal).max() < 1e-2
    assert np.abs(np.linalg.norm(off["sphere"], axis=-1) - 100).max() < 1e-2 and priors["sphere"].depth.max() < 900
    from_axis = np.linalg.norm(np.cross(off["cylinder"], axis / np.linalg.norm(axis)), axis=-1)
    assert np.abs(from_axis - 100).max() < 1e-2
    images = np.random.default_rng(1).uniform(0.2, 0.3, (4, 96, 96))
    for kind, prior in priors.items():
        np.testing.assert_allclose(prior.sigma, 0.5)
        assert prior.camera == turned.undistorted() and prior.noise == 0
        given: Any = {kind: shapes[kind], "sigma": 0.5}
        station = malus.Station(images, [0, 45, 90, 135], turned, prior=given)
        found = malus.reconstruct(station, malus.Options(capture={"registration": "off"}), until="prior", threads=1)
        np.testing.assert_allclose(found.prior_depth, prior.depth, rtol=1e-6)


@pytest.mark.parametrize(
    ("shape", "sigma", "message"),
    [
        ({}, 1, "0 shapes, expected exactly one"),
        ({"ball": {}}, 1, r"\[prior\].ball: unknown key"),
        ({"sphere": {"center": [0, 0, 900], "radius": -3}}, 1, r"\[prior\].sphere.radius = -3"),
        ({"sphere": {"center": [0, 0, np.nan], "radius": 3}}, 1, r"shape: \[sphere\].center\[2\] = nan"),
        ({"plane": {"point": [0, 0, 900], "normal": [0, 0, 0]}}, 1, r"\[prior\].plane.normal.*not all zero"),
        ({"plane": {"point": [0, 0, 900], "normal": [0, 0, 1]}}, 0, "prior.sigma = 0"),
    ],
)
def test_shapes_that_are_none_are_refused(dome: Dome, shape: Any, sigma: float, message: str) -> None:
    with pytest.raises(malus.InputError, match=message):
        malus.prior.project_shape(shape, sigma, dome.camera)


def test_a_depth_maps_prior_stands_where_its_camera_does(turned: Camera) -> None:
    """It stood in the camera's frame, and so did the mesh of a surface fused with it."""
    assert malus.prior.project_depth(np.full((96, 96), 800.0), turned).camera == turned.undistorted()


def test_priors_of_swept_depths_on_arrays(dome: Dome) -> None:
    v, u = np.mgrid[:96, :96].astype(float)
    smooth, gsd = 800 + 4 * ((u - 47.5) ** 2 + (v - 47.5) ** 2) / 48**2, dome.scene.gsd
    sigma = np.full((96, 96), 0.3 * gsd)
    holed = smooth.copy()
    holed[30:50, 40:60] = np.nan
    prior = malus.prior.project_swept(holed, sigma, dome.camera)
    assert np.abs(prior.depth - smooth)[4:-4, 4:-4].max() < gsd
    assert (prior.sigma > 0.299 * gsd).all() and prior.sigma[40, 50] > 5 * gsd
    assert prior.noise > 0 and prior.filled_fraction == pytest.approx(400 / 96**2)
    # The detail of a known surface stays.
    known = malus.prior.project_swept(dome.scene.depth, sigma, dome.camera, surface=dome.scene.depth)
    assert np.abs(known.depth - dome.scene.depth).max() < 0.05 * gsd
    with pytest.raises(ValueError, match=r"sigma has shape \(3, 3\), expected \(96, 96\) as its camera"):
        malus.prior.project_swept(holed, np.ones((3, 3)), dome.camera)


def test_confidence_on_arrays_knows_the_prior(dome: Dome) -> None:
    """That the prior's standard deviation is assumed, or much of it interpolated, was told by runs only."""
    v, u = np.mgrid[:96, :96].astype(float)
    depth = 800 + 4 * ((u - 47.5) ** 2 + (v - 47.5) ** 2) / 48**2

    def reasons(options: malus.Options | None = None) -> str:
        prior = malus.prior.project_depth(depth, dome.camera, options=options)
        confidence = malus.fusion.refine(dome.state, prior, threads=2).confidence
        return " ".join(confidence["reasons"])

    assert "standard deviation of the coarse surface is assumed" in reasons()
    depth[:, 30:60] = np.nan
    stated = reasons(malus.Options(prior={"sigma": 0.5}))
    assert "is assumed" not in stated and "On 31 % of the object the prior has no data of its own" in stated


def test_light_on_arrays(dome: Dome) -> None:
    """The lamp's direction, from known normals and from the polarization alone."""
    direction = np.array(LAMP) / np.linalg.norm(LAMP)
    found = malus.height.light(dome.state.unpolarized, dome.normals, camera=dome.camera)["light"]
    assert direction @ found[:3] / np.linalg.norm(found[:3]) > np.cos(np.radians(3))
    reflection = malus.polarization.map_reflection(dome.state, camera=dome.camera, reflection="diffuse")
    found = malus.height.light_from_polarization(dome.state, reflection, camera=dome.camera)["light"]
    assert direction @ found[:3] / np.linalg.norm(found[:3]) > np.cos(np.radians(15))


def test_fusions_on_arrays(dome: Dome) -> None:
    """A prior without the ripples: each of the three kinds of fusion restores most of them."""
    v, u = np.mgrid[:96, :96].astype(float)
    smooth = 800 + 4 * ((u - 47.5) ** 2 + (v - 47.5) ** 2) / 48**2
    camera = dome.camera
    prior = malus.prior.project_depth(smooth, camera)
    normals = malus.surface.normals_from_depth(smooth, camera)
    reflection = malus.polarization.map_reflection(
        dome.state, camera=camera, prior_normals=normals, reflection="diffuse"
    )
    height = malus.height.solve(dome.state, reflection, camera=camera, prior_normals=normals, threads=2)
    assert height.status == "converged"
    by_grid = malus.fusion.fuse_grid(height, prior, threads=2)
    together = malus.fusion.optimize_grid(by_grid, dome.state, reflection, prior, height, threads=2)
    refined = malus.fusion.refine(dome.state, prior, threads=2)
    before = dome.detail_gsd(prior.depth)
    after = {"grid": by_grid, "together": together, "refined": refined}
    errors = {name: dome.detail_gsd(surface.depth) / before for name, surface in after.items()}
    assert max(errors.values()) < 0.5, errors
    assert by_grid is not together and not np.array_equal(by_grid.depth, together.depth)


def test_a_stated_reflection_on_arrays(dome: Dome) -> None:
    """A name for all pixels or a label for each; the dome is matte, so that a mirroring one explains nothing."""
    labels = np.ones(dome.state.degree.shape, np.int64)
    half = np.where(np.arange(96) < 48, 2, labels)
    found = malus.polarization.map_reflection(dome.state, reflection=half)
    usable = dome.state.valid == 255
    np.testing.assert_array_equal(found.label[usable], half[usable])
    v, u = np.mgrid[:96, :96].astype(float)
    prior = malus.prior.project_depth(800 + 4 * ((u - 47.5) ** 2 + (v - 47.5) ** 2) / 48**2, dome.camera)
    options = malus.Options(refine={"lobe": False, "surroundings": False})
    diffuse, labeled, specular = (
        malus.fusion.refine(dome.state, prior, reflection=reflection, options=options, threads=2).depth
        for reflection in ("diffuse", labels, "specular")
    )
    np.testing.assert_allclose(labeled, diffuse, rtol=1e-6)
    assert dome.detail_gsd(diffuse) < 0.5 * dome.detail_gsd(prior.depth)
    assert dome.detail_gsd(specular) > 1.5 * dome.detail_gsd(diffuse)
    for step in (malus.polarization.map_reflection, lambda state, **given: malus.fusion.refine(state, prior, **given)):
        with pytest.raises(malus.InputError, match='reflection = "matte", expected "auto"'):
            step(dome.state, reflection="matte")
        with pytest.raises(ValueError, match=r"reflection has shape \(3, 3\), expected \(96, 96\)"):
            step(dome.state, reflection=np.ones((3, 3)))
    with pytest.raises(malus.InputError, match='optics.metal = "bronz", expected .*"bronze"'):
        malus.fusion.refine(dome.state, prior, metal="bronz")
    with pytest.raises(malus.InputError, match=r'optics.metal = "0.7\+2.6i", expected .* reflection = "diffuse"'):
        malus.fusion.refine(dome.state, prior, metal=(0.7, 2.6), reflection="diffuse")
    with pytest.raises(ValueError, match=r"metal has shape \(3,\), expected a word or the two numbers n and k"):
        malus.fusion.refine(dome.state, prior, metal=[0.7, 2.6, 0.0])


def test_height_may_start_from_a_prior_on_arrays(dome: Dome) -> None:
    """As the height of a station does; the option height.boundary = "prior" was always an error."""
    v, u = np.mgrid[:96, :96].astype(float)
    smooth = 800 + 4 * ((u - 47.5) ** 2 + (v - 47.5) ** 2) / 48**2
    normals = malus.surface.normals_from_depth(smooth, dome.camera)
    reflection = malus.polarization.map_reflection(
        dome.state, camera=dome.camera, prior_normals=normals, reflection="diffuse"
    )
    held: dict[str, Any] = {"options": malus.Options(height={"boundary": "prior"}), "prior_normals": normals}
    height = malus.height.solve(
        dome.state, reflection, camera=dome.camera, prior_depth=smooth, threads=2, **held
    ).height
    prior = -1600 * (np.log(smooth) - np.log(smooth).mean())
    ring = np.ones((96, 96), bool)
    ring[2:-2, 2:-2] = False
    assert np.nanmedian(np.abs(height - prior)[ring]) < 1
    with pytest.raises(malus.InputError, match="needs the height of the prior"):
        malus.height.solve(dome.state, reflection, camera=dome.camera, **held)
    with pytest.raises(malus.InputError, match="prior_depth needs the camera"):
        malus.height.solve(dome.state, reflection, prior_depth=smooth)
    with pytest.raises(ValueError, match=r"prior_depth has shape \(95, 96\), expected \(96, 96\)"):
        malus.height.solve(dome.state, reflection, camera=dome.camera, prior_depth=smooth[1:])


def test_mesh_and_assessment_on_arrays() -> None:
    camera = Camera("PINHOLE", 40, 30, [400.0, 400.0, 19.5, 14.5])
    u = np.indices((30, 40))[1].astype(float)
    depth = 100 / (1 + 0.1 * (u - 19.5) / 400)  # the plane z + 0.1 x = 100
    normal = np.array([-0.1, 0, -1]) / np.hypot(0.1, 1)
    surface = malus.fusion.FusedSurface(depth, np.broadcast_to(normal, (30, 40, 3)), np.full((30, 40), 0.01), camera)
    mesh = malus.surface.mesh_from_depth(surface)
    assert len(mesh.vertices) == 1200 and len(mesh.triangles) == 2 * 29 * 39
    np.testing.assert_allclose(mesh.vertices @ normal, -100 / np.hypot(0.1, 1), atol=1e-4)

    patch = malus.assess.fit_patch(depth, camera, (5, 5, 34, 24), 0.25)
    with pytest.raises(ValueError, match="expected finite numbers"):
        malus.assess.fit_patch(depth, camera, (5, 5, 34, np.inf), 0.25)  # type: ignore[arg-type]
    assert patch is not None and patch["count"] == 600 and patch["rmse_gsd"] < 1e-4
    behind = mesh.vertices + 0.2 * -normal
    away = malus.Options(assess={"alignment": "none"})
    compared = malus.assess.compare(surface, behind, 0.25, triangles=mesh.triangles, options=away)
    np.testing.assert_allclose(compared["distance"][2:-2, 2:-2], 0.2, atol=1e-3)
    assert compared["rmse_gsd"] == pytest.approx(0.8, abs=0.01) and compared["compared_fraction"] > 0.9

    step = depth.copy()
    step[:, 20:] -= 0.5
    section = malus.assess.profile(step, camera, (2, 15), (37, 15), 0.25, prior=depth)
    assert np.nanmax(section["surface"]) - np.nanmin(section["surface"]) == pytest.approx(0.5, rel=0.2)
    assert section["difference_rms_gsd"] > 0.5


@pytest.mark.parametrize("row", ROWS, ids=[row[0] for row in ROWS])
def test_each_step_exists_as_the_table_says(row: list[str]) -> None:
    step, command, python, library = row
    assert of_python(python), f"{step} has no function in Python"
    tests = "".join(path.read_text(encoding="utf-8") for path in Path(__file__).parent.glob("test_*.py"))
    for name in of_python(python):
        parent, _, last = name.rpartition(".")
        try:
            thing = importlib.import_module(parent)
        except ModuleNotFoundError:
            thing = getattr(malus, parent.rpartition(".")[2])
        function = getattr(thing, last)
        assert callable(function) and inspect.getdoc(function), name
        # Tests of `malus paper` run the command, which calls its functions; the functions of other steps are called by a test.
        # The search includes the module's name: another module may have a function of the same name.
        called = ".".join(name.split(".")[-2:]) if parent != "malus.Camera" else f"camera.{last}"
        assert re.search(rf"\b{re.escape(called)}\(", tests) or command == "`malus paper`", (
            f"{name} is called by no test"
        )
    for word in re.findall(r"`malus (\w+)", command):
        assert malus_here(word, "--help").code == 0
    for function, header in re.findall(r"`(\w+)` \(`([\w/]+\.h)`\)", library):
        assert re.search(rf"\b{function}\(", (ROOT / "cpp" / "malus" / header).read_text(encoding="utf-8"))
