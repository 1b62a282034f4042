"""Each step called with arrays: results against the truth, and errors for wrong shapes."""

from __future__ import annotations

import copy
import pickle
import runpy
from collections.abc import Callable

import numpy as np
import pytest

import malus
from conftest import ROOT, SHARED, needs_shared, turns_of_another_thread

ANGLES = np.radians([0, 30, 60, 90, 120, 150])


def polarized(i_un: np.ndarray, rho: np.ndarray, phi: np.ndarray) -> list[np.ndarray]:
    return [i_un * (1 + rho * np.cos(2 * (a - phi))) for a in ANGLES]


@pytest.fixture
def maps() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    shape = (40, 50)
    return rng.uniform(0.2, 0.7, shape), rng.uniform(0.05, 0.4, shape), rng.uniform(0, np.pi, shape)


def test_decompose_recovers_the_sinusoid(maps: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    i_un, rho, phi = maps
    state = malus.polarization.decompose(polarized(i_un, rho, phi), ANGLES)
    np.testing.assert_allclose(state.unpolarized, i_un, atol=1e-6)
    np.testing.assert_allclose(state.degree, rho, atol=2e-6)
    np.testing.assert_allclose(np.cos(2 * (state.phase_rad - phi)), 1, atol=1e-6)
    assert (state.valid == 255).all()


def test_decompose_equals_polanalyser(maps: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    polanalyser = pytest.importorskip("polanalyser")
    rng = np.random.default_rng(2)
    images = [image + rng.normal(0, 0.003, image.shape) for image in polarized(*maps)]
    state = malus.polarization.decompose(images, ANGLES)
    stokes = polanalyser.calcStokes(np.stack([np.float32(i) for i in images]), list(ANGLES))
    np.testing.assert_allclose(state.unpolarized, polanalyser.cvtStokesToIntensity(stokes) / 2, atol=1e-6)
    np.testing.assert_allclose(state.degree, polanalyser.cvtStokesToDoLP(stokes), atol=1e-6)
    aolp = polanalyser.cvtStokesToAoLP(stokes)
    np.testing.assert_allclose(state.degree * np.sin(2 * (state.phase_rad - aolp)), 0, atol=1e-6)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_any_memory_layout_is_accepted(maps: tuple[np.ndarray, np.ndarray, np.ndarray], dtype: type) -> None:
    images = [np.asfortranarray(image.astype(dtype)) for image in polarized(*maps)]
    strided = [np.repeat(image, 2, axis=1)[:, ::2] for image in images]
    reference = malus.polarization.decompose([np.ascontiguousarray(i) for i in images], ANGLES)
    np.testing.assert_array_equal(malus.polarization.decompose(images, ANGLES).degree, reference.degree)
    np.testing.assert_array_equal(malus.polarization.decompose(strided, ANGLES).degree, reference.degree)


def test_16_bit_images_are_white_at_65535(maps: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    counts = [np.rint(65535 * np.clip(image, 0, 1)).astype(np.uint16) for image in polarized(*maps)]
    state = malus.polarization.decompose(counts, ANGLES)
    reference = malus.polarization.decompose([np.float32(image / 65535) for image in counts], ANGLES)
    np.testing.assert_allclose(state.unpolarized, reference.unpolarized, atol=1e-6)
    np.testing.assert_allclose(state.degree, reference.degree, atol=1e-6)
    np.testing.assert_array_equal(state.valid, reference.valid)


def test_wrong_shapes_are_named(maps: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    images = polarized(*maps)
    with pytest.raises(ValueError, match=r"images\[2\] has shape \(39, 50\), expected \(40, 50\)"):
        malus.polarization.decompose([*images[:2], images[2][1:], *images[3:]], ANGLES)
    with pytest.raises(ValueError, match=r"images\[0\] has shape \(40,\), expected \(H, W\)"):
        malus.polarization.decompose([image[:, 0] for image in images], ANGLES)
    with pytest.raises(ValueError, match=r"mask has shape \(3, 3\), expected \(40, 50\)"):
        malus.polarization.decompose(images, ANGLES, mask=np.ones((3, 3)))
    with pytest.raises(ValueError, match="expected numbers"):
        malus.polarization.decompose([np.full((4, 4), "x")] * 6, ANGLES)
    with pytest.raises(malus.DataError, match="2 distinct modulo 180 deg, expected at least 3"):
        malus.polarization.decompose(images, [0, np.pi / 2, np.pi, 0, np.pi / 2, np.pi])


def test_fresnel_degrees() -> None:
    zenith = np.linspace(0, 1.5, 50)
    for eta in (1.3, 1.5, 1.8):
        diffuse = malus.polarization.diffuse_degree(zenith, eta)
        np.testing.assert_allclose(malus.polarization.diffuse_zenith(diffuse, eta), zenith, atol=np.radians(1e-6))
        s, c = np.sin(zenith), np.cos(zenith)
        t = np.sqrt(1 - (s / eta) ** 2)
        rs, rp = ((c - eta * t) / (c + eta * t)) ** 2, ((t - eta * c) / (t + eta * c)) ** 2
        np.testing.assert_allclose(diffuse, (rs - rp) / (2 - rs - rp), atol=1e-9)
        np.testing.assert_allclose(malus.polarization.specular_degree(zenith, eta), (rs - rp) / (rs + rp), atol=1e-9)
    assert malus.polarization.brewster_angle(1.5) == pytest.approx(np.arctan(1.5))
    for function in ("diffuse_degree", "specular_degree", "diffuse_zenith", "specular_zenith", "brewster_angle"):
        for eta in (0.9, 1.0, 3.2, np.nan):
            with pytest.raises(malus.InputError, match=r"refractive_index = .*, expected a value from 1.05 to 3"):
                getattr(malus.polarization, function)(*([] if function == "brewster_angle" else [0.1]), eta)


def test_options_are_checked() -> None:
    options = malus.Options(fusion="grid", height={"smoothness": 0.2})
    assert options.height.smoothness == 0.2
    options.set("grid.grid_px=8")
    assert options.grid.grid_px == 8
    assert malus.Options(**options.to_dict()) == options
    with pytest.raises(malus.InputError, match=r"unknown option refine.foo, expected one of refine\.\w+, refine\."):
        options.set("refine.foo=1")
    with pytest.raises(malus.InputError, match="did you mean height.smoothness"):
        options.height.smothness = 1
    with pytest.raises(malus.InputError, match="expected a whole number"):
        options.grid.grid_px = 1.5
    with pytest.raises(malus.InputError, match="from 1 to"):
        options.grid.grid_px = 0
    options.update({"prior": {"sigma": np.float32(0.25)}, "grid": {"grid_px": np.int64(6)}})
    assert (options.prior.sigma, options.grid.grid_px) == (0.25, 6)
    for wrong in (np.nan, np.float32("inf"), np.zeros(2)):
        with pytest.raises(malus.InputError, match=r"option prior.sigma = .*expected a "):
            options.update({"prior": {"sigma": wrong}})
    with pytest.raises(ValueError):
        malus.Options(fusion="magic")
    assert all(doc for _, _, _, doc in malus.Options.describe())


def test_options_are_set_by_assignment_or_refused() -> None:
    """Attributes of other names, and mappings that replaced a section, were kept and never used."""
    options = malus.Options(height={"iterations": 7})
    options.height = {"smoothness": 0.2}
    assert (options.height.smoothness, options.height.iterations) == (0.2, 7)
    assert options.to_dict()["height"]["smoothness"] == 0.2
    other = malus.Options()
    other.height = options.height
    assert other == options
    with pytest.raises(malus.InputError, match="unknown option section fuson; did you mean fusion"):
        options.fuson = "grid"
    with pytest.raises(malus.InputError, match=r"option section height = 3, expected a table"):
        options.height = 3
    options.fusion = "grid"
    assert options.to_dict()["fusion"] == "grid"


def test_options_can_be_copied_and_pickled() -> None:
    options = malus.Options(height={"smoothness": 0.2})
    for copied in (copy.copy(options), copy.deepcopy(options), pickle.loads(pickle.dumps(options))):
        assert copied == options
        copied.height.smoothness = 0.3
        assert options.height.smoothness == 0.2
    assert pickle.loads(pickle.dumps(options.height)).smoothness == 0.2
    assert copy.copy(options.height).smoothness == 0.2


def test_option_type_file_matches_the_library() -> None:
    """If this fails, editors suggest options that do not exist: run scripts/option_types.py."""
    script = runpy.run_path(str(ROOT / "scripts/option_types.py"))
    assert script["TARGET"].read_text(encoding="utf-8") == script["text"]()
    options = malus.Options()
    assert {"height", "refine", "fusion", "set"} <= set(dir(options))
    assert "smoothness" in dir(options.height)


def test_nan_in_a_mask_is_no_object(maps: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    mask = np.full((40, 50), np.nan)
    mask[10:20, 10:20] = 1
    state = malus.polarization.decompose(polarized(*maps), ANGLES, mask=mask)
    np.testing.assert_array_equal(np.isfinite(state.degree), np.isfinite(mask))


def test_16_bit_images_may_have_any_byte_order(maps: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    """Readers of big-endian files give '>u2'; these were refused with "expected … uint16"."""
    counts = [np.rint(65535 * np.clip(image, 0, 1)).astype(np.uint16) for image in polarized(*maps)]
    expected = malus.polarization.decompose(counts, ANGLES)
    found = malus.polarization.decompose([image.astype(">u2") for image in counts], ANGLES)
    np.testing.assert_array_equal(found.degree, expected.degree)
    np.testing.assert_array_equal(found.valid, expected.valid)


def test_nan_does_not_hide_intensities_of_another_scale(maps: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    images = [255 * image for image in polarized(*maps)]
    images[0][3, 4] = np.nan
    with pytest.raises(ValueError, match=r"images\[0\] reaches .*expected linear intensities in \[0, 1\]"):
        malus.polarization.decompose(images, ANGLES)


@pytest.mark.parametrize(
    "noise", [{"full_well_e": 0.0}, {"full_well_e": np.inf}, {"read_noise_e": -1.0}, {"frames_averaged": 0}]
)
def test_impossible_noise_is_refused(maps: tuple[np.ndarray, np.ndarray, np.ndarray], noise: dict[str, float]) -> None:
    """Their variances are infinite or NaN, and every pixel followed the sinusoid."""
    images, said = polarized(*maps), f"{next(iter(noise))} = .*expected"
    for call in (malus.polarization.decompose, malus.polarization.calibrate):
        with pytest.raises(ValueError, match=said):
            call(images, ANGLES, **noise)
    with pytest.raises(ValueError, match=said):
        malus.capture.register(images, **noise)


def test_masked_values_are_not_read(maps: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    """Below its mask an array has the file's value for no data, -9999 of a depth map for example."""
    images = [np.ma.masked_array(image, np.zeros(image.shape, bool)) for image in polarized(*maps)]
    state = malus.polarization.decompose(images, ANGLES)
    assert (state.valid == 255).all(), "nothing is masked"
    images[2][3, 4] = np.ma.masked
    with pytest.raises(ValueError, match=r"images\[2\] has masked values, expected .*filled"):
        malus.polarization.decompose(images, ANGLES)
    camera = malus.Camera("PINHOLE", 50, 40, [100.0, 100.0, 24.5, 19.5])
    depth = np.ma.masked_equal(np.full((40, 50), 100.0), 100.0)
    with pytest.raises(ValueError, match="prior_depth has masked values"):
        malus.Station(polarized(*maps), np.degrees(ANGLES), camera, prior_depth=depth)
    with pytest.raises(ValueError, match="depth has masked values"):
        malus.prior.project_depth(depth, camera)
    with pytest.raises(ValueError, match="mask has masked values"):
        malus.polarization.decompose(polarized(*maps), ANGLES, mask=depth)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda m, camera: m.prior.project_points([[1, 2], [3]], camera), "points has parts of different lengths"),
        (lambda m, camera: m.prior.project_points([["a", "b", "c"]], camera), "points has type .*expected numbers"),
        (
            lambda m, camera: m.prior.project_points(np.ma.masked_equal([[1.0, 2.0, 3.0]], 2.0), camera),
            "points has masked values",
        ),
        (
            lambda m, camera: m.prior.project_mesh(np.eye(3), [[0, 1, 1.5]], camera),
            "triangles has fractions, expected whole",
        ),
        (
            lambda m, camera: m.prior.project_mesh(np.eye(3), [[0, 1, 3]], camera),
            "triangles has indices from 0 to 3, expected 0 to 2",
        ),
        (
            lambda m, camera: m.surface.dem_from_mesh(
                m.surface.Mesh(np.eye(3), np.eye(3), np.empty((0, 3), np.uint8), np.array([[0, 1, 3]])),
                m.fusion.FusedSurface(np.ones((40, 50)), np.ones((40, 50, 3)), np.ones((40, 50)), camera),
            ),
            "triangles has indices from 0 to 3, expected 0 to 2",
        ),
        (lambda m, camera: m.polarization.diffuse_degree(["x"]), "zenith_rad has type"),
        (lambda m, camera: m.polarization.specular_zenith([[0.1], [0.1, 0.2]]), "degree has parts of different"),
        (lambda m, camera: m.capture.linearize([["x"]]), "image has type"),
        (
            lambda m, camera: m.capture.linearize([[[0.1, 0.2, 0.3], [0.1, np.nan, 0.3]]]),
            r"image: pixel \(1, 0\) is not a finite number",
        ),
        (lambda m, camera: camera.resected(np.eye(3), [["x", "y"]] * 3), "pixels has type"),
        (
            lambda m, camera: m.fusion.FusedSurface(np.ones((40, 50)), np.ones((40, 50)), np.ones((40, 50)), camera),
            r"normals has shape \(40, 50\), expected \(40, 50, 3\)",
        ),
        (
            lambda m, camera: m.fusion.FusedSurface(np.ones((40, 50)), np.ones((40, 50, 3)), np.ones((50, 40)), camera),
            r"sigma has shape \(50, 40\), expected \(40, 50\)",
        ),
        (
            lambda m, camera: m.prior.DepthPrior(np.ones((40, 49)), np.ones((40, 50)), camera),
            r"depth has shape \(40, 49\), expected \(40, 50\)",
        ),
        (
            lambda m, camera: m.prior.DepthPrior(np.ma.masked_equal(np.eye(40, 50), 0), np.ones((40, 50)), camera),
            "depth has masked values",
        ),
        (
            lambda m, camera: m.fusion.FusedSurface(
                np.ones((40, 50)), np.ones((40, 50, 3)), np.ma.masked_equal(np.eye(40, 50), 0), camera
            ),
            "sigma has masked values",
        ),
        (lambda m, camera: m.prior.DepthPrior([["x"] * 50] * 40, np.ones((40, 50)), camera), "depth has type"),
        (
            lambda m, camera: m.surface.write_dem(
                "dem.tif",
                m.surface.Dem(np.ma.masked_equal(np.eye(4), 0), 1.0, np.zeros(3), *np.eye(3)),
                unit="mm",
                name="stone",
            ),
            "elevation has masked values",
        ),
        (
            lambda m, camera: m.evidence.check_size([[0, 0, 100], [np.nan, 1, 100]], camera),
            "points_in_cam has numbers that are not finite",
        ),
        (
            lambda m, camera: m.surface.normals_from_depth(np.ones((20, 25)), camera),
            r"depth has shape \(20, 25\), expected \(40, 50\) as its camera",
        ),
        (
            lambda m, camera: m.assess.fit_patch(np.ones((20, 25)), camera, (0, 0, 9, 9), 0.1),
            r"depth has shape \(20, 25\), expected \(40, 50\) as its camera",
        ),
        (
            lambda m, camera: m.assess.profile(np.ones((40, 50)), camera, (0, 5), (9, 5), 0.1, prior=np.ones((20, 25))),
            r"prior has shape \(20, 25\), expected \(40, 50\) as its camera",
        ),
        (
            lambda m, camera: m.assess.fit_patch(np.ones((40, 50)), camera, (0, 0, 9, 9), 0),
            "gsd = 0, expected a positive length",
        ),
    ],
)
def test_wrong_arguments_are_named(call: Callable[..., object], said: str) -> None:
    """Their names were missing, or values below a mask, fractions and rasters of another size were taken as they are."""
    camera = malus.Camera("PINHOLE", 50, 40, [100.0, 100.0, 24.5, 19.5])
    with pytest.raises(ValueError, match=said):
        call(malus, camera)


def test_rasters_of_steps_cannot_be_changed(maps: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    """Each access made a copy: what was written into it was lost without a message, such as `prior.depth[hole] = nan`."""
    camera = malus.Camera("PINHOLE", 50, 40, [100.0, 100.0, 24.5, 19.5])
    state = malus.polarization.decompose(polarized(*maps), ANGLES)
    reflection = malus.polarization.map_reflection(state)
    given = np.ones((40, 50), np.float32)
    prior = malus.prior.DepthPrior(given, given, camera)
    surface = malus.fusion.FusedSurface(given, np.ones((40, 50, 3), np.float32), given, camera)
    height = malus.height.solve(state, reflection, light=[0, 0, -1, 0.1])
    for owner, names in (
        (prior, "depth sigma"),
        (surface, "depth normals sigma"),
        (reflection, "label zenith_rad"),
        (height, "height"),
        (state, "unpolarized degree phase_rad residual valid"),
    ):
        for name in names.split():
            raster = getattr(owner, name)
            assert raster.shape == ((40, 50, 3) if name == "normals" else (40, 50))
            with pytest.raises(ValueError, match="read-only"):
                raster[0, 0] = 0
            assert np.shares_memory(raster, getattr(owner, name)), name
    given[:] = 2
    depth = prior.depth
    del prior
    assert (depth == 1).all(), "the arrays that were given are copied, and a raster outlives its owner's name"


def test_cameras_of_other_images_are_refused(maps: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    """With the camera of the full images, maps of halved images had the rays of their upper left quarter, and no message."""
    state = malus.polarization.decompose(polarized(*maps), ANGLES)
    reflection = malus.polarization.map_reflection(state)
    normals = np.broadcast_to(np.float32([0, 0, -1]), (40, 50, 3))
    camera = malus.Camera("PINHOLE", 100, 80, [200.0, 200.0, 49.5, 39.5])
    for call in (
        lambda: malus.polarization.map_reflection(state, camera=camera),
        lambda: malus.polarization.calibrate_with_surface(state, normals, camera=camera),
        lambda: malus.evidence.check_phase(state, normals, camera=camera),
        lambda: malus.evidence.check_depth(np.ones((80, 100)), state, camera),
        lambda: malus.height.light(state.unpolarized, normals, camera=camera),
        lambda: malus.height.light_from_polarization(state, reflection, camera=camera),
        lambda: malus.height.solve(state, reflection, camera=camera, light=[0, 0, -1, 0]),
    ):
        with pytest.raises(ValueError, match=r"camera has shape \(80, 100\), expected \(40, 50\) as "):
            call()


def test_wrong_angles_are_named(maps: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    images = polarized(*maps)
    calls = (malus.polarization.decompose, malus.polarization.calibrate, malus.evidence.check_order)
    for call in calls:
        with pytest.raises(ValueError, match=r"angles_rad has shape \(5,\), expected \(6,\): one angle per image"):
            call(images, ANGLES[:5])
        with pytest.raises(ValueError, match=r"angles_rad has shape \(6, 1\)"):
            call(images, ANGLES[:, None])
        with pytest.raises(ValueError, match=r"angles_rad\[1\] = 30 .*looks like degrees"):
            call(images, np.degrees(ANGLES))
        # With such an angle no polarizer has a finite cost; the calibration then ended the process.
        for angle in (np.nan, np.inf):
            with pytest.raises(ValueError, match=rf"angles_rad\[5\] = {angle}, expected a finite number"):
                call(images, [*ANGLES[:5], angle])
    camera = malus.Camera("PINHOLE", 50, 40, [100.0, 100.0, 24.5, 19.5])
    with pytest.raises(ValueError, match="angles_deg has type .*expected numbers"):
        malus.Station(images, ["0°"] * 6, camera)  # type: ignore[list-item]


def test_other_threads_run_while_large_arrays_are_computed() -> None:
    """The Fresnel functions held the interpreter's lock, so that Ctrl-C had to wait, too."""
    degrees = np.full((2500, 4000), 0.1)
    found: list[np.ndarray] = []
    assert turns_of_another_thread(lambda: found.append(malus.polarization.specular_zenith(degrees))) > 3
    (zeniths,) = found
    assert zeniths.shape == degrees.shape and np.ptp(zeniths) == 0
    assert zeniths[0, 0] == malus.polarization.specular_zenith(0.1)


def mean_normal_error_deg(height: np.ndarray, normal: np.ndarray, mask: np.ndarray) -> float:
    """Mean angle between `normal` (y up) and the normals of a height in pixels, by central differences within the mask's border."""
    inner = mask.copy()
    inner[1:-1, 1:-1] = mask[1:-1, 1:-1] & mask[:-2, 1:-1] & mask[2:, 1:-1] & mask[1:-1, :-2] & mask[1:-1, 2:]
    down, right = np.gradient(height)
    found = np.stack([-right, down, np.ones_like(height)], -1)
    found /= np.linalg.norm(found, axis=-1, keepdims=True)
    cosine = np.clip((found * normal).sum(-1), -1, 1)
    return float(np.degrees(np.arccos(cosine))[inner].mean())


@needs_shared
@pytest.mark.parametrize(
    ("name", "limit_deg"),
    [
        ("sphere_256_n0", 0.05),
        ("bumpy_256_n0", 0.1),
        ("sphere_256_n0.005", 0.85),
        ("bumpy_256_n0.005", 1.3),
        ("spheretilt30y_128_n0.005", 0.8),
    ],
)
def test_height_from_polarization_alone(name: str, limit_deg: float) -> None:
    data = np.load(SHARED / "data/synthetic" / f"{name}.npz")
    mask = data["mask"].astype(bool)
    images = [data["images"][..., k] for k in range(data["images"].shape[-1])]
    state = malus.polarization.decompose(images, data["angles"], mask=mask)
    reflection = malus.polarization.map_reflection(state, reflection="diffuse")
    x, y, z = data["light"]
    height = malus.height.solve(
        state, reflection, light=[x, -y, -z, 0.0], options=malus.Options(height={"perspective": False}), threads=2
    )
    assert height.status == "converged"
    assert mean_normal_error_deg(height.height.astype(float), data["normal"], mask) <= limit_deg
    truth = data["z"][mask] - data["z"][mask].mean()
    scale = float((height.height[mask] * truth).sum() / (truth * truth).sum())
    assert scale == pytest.approx(1, abs=0.05)
