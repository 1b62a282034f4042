"""Types of the private extension; see the package's own modules for documentation."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus.camera import Camera

_Float32 = NDArray[np.float32]
_Float64 = NDArray[np.float64]
_Bytes = NDArray[np.uint8]

version: str
refined_nowhere: float
refined_everywhere: float
least_silhouettes: int
length_units: dict[str, float]
finest_level: int
image_suffixes: list[str]
raw_suffixes: list[str]

def option_schema() -> str: ...
def default_options() -> str: ...
def preset_options(name: str) -> str: ...
def presets() -> list[tuple[str, str]]: ...
def check_options(json: str) -> str: ...
def set_option(json: str, assignment: str) -> str: ...
def options_from_file(json: str, path: str) -> str: ...
def step_names() -> list[str]: ...
def describe_run(options: str, until: str | None) -> list[tuple[str, str, list[str]]]: ...
def claim_workspace(folder: str, station: Station, replace: bool) -> None: ...
def overtaken_exports(folder: str) -> list[str]: ...
def surface_confidence(folder: str) -> tuple[str, list[str], bool] | None: ...
def read_manifest(folder: str) -> str: ...
def surface_words(quality: str) -> str: ...
def surface_extras(quality: str, versions: str) -> str: ...
def forget_step(folder: str, step: str) -> None: ...
def record_step(folder: str, step: str, files: list[str], times: str) -> None: ...
def toml_as_json(path: Any, what: str) -> str: ...
def read_raster(path: str) -> _Float32: ...
def read_points(path: str) -> _Float64: ...
def read_cloud_or_mesh(path: str) -> tuple[_Float64, NDArray[np.uint32] | None]: ...
def read_oriented_points(path: str) -> tuple[_Float64, _Float64 | None]: ...
def write_float_tiff(path: str, image: _Float32) -> None: ...
def write_png16(path: str, image: NDArray[np.uint16]) -> None: ...
def write_tiff16(path: str, image: NDArray[np.uint16]) -> None: ...

class Station:
    @staticmethod
    def load(path: str, photos_of: str | None) -> Station: ...
    @staticmethod
    def from_arrays(
        *,
        images: Sequence[_Float32],
        whole_numbers: bool,
        camera: _CameraValues | None,
        tables: str,
        prior_points: _Float64 | None,
        prior_normals: _Float32 | None,
        prior_triangles: NDArray[np.uint32] | None,
        prior_depth: _Float32 | None,
        mask: _Bytes | None,
        labels: _Bytes | None,
    ) -> Station: ...
    def describe(self) -> str: ...
    def with_developed(self, images: list[str], full_well_e: float | None, read_noise_e: float | None) -> Station: ...
    def with_file_doubts(self, doubts: list[tuple[str, str, str]], notes: list[tuple[str, str, str]]) -> Station: ...
    def with_curves_of(self, pixels: list[tuple[int, int]]) -> Station: ...
    def with_cloud(self, points: _Float64, normals: _Float32 | None) -> Station: ...
    def with_photogrammetry(
        self,
        camera: _CameraValues,
        swept: dict[str, _Float32] | None,
        figures: str,
        times: str,
        warnings: list[str],
        files: dict[Path, str],
    ) -> Station: ...

class Results: ...

def photos_tables(path: str) -> str: ...
def reconstruct(
    station: Station,
    options: str,
    threads: int,
    workspace: str | None = None,
    replace: bool = False,
    until: str | None = None,
    reference: str | None = None,
    keep_maps: bool = True,
    known: Results | None = None,
    progress: Callable[[str, float, str], None] | None = None,
    log: Callable[[str, str], None] | None = None,
) -> dict[str, Any]: ...
def check(station: Station, options: str, threads: int) -> str: ...
def expected_times(
    station: Station, options: str, until: str | None, size: tuple[int, int] | None, threads: int
) -> list[tuple[str, float]]: ...
def check_picture(station: Station, threads: int) -> tuple[_Float32, _Bytes, _Float32]: ...

class PolarizationState:
    @property
    def unpolarized(self) -> _Float32: ...
    @property
    def degree(self) -> _Float32: ...
    @property
    def phase_rad(self) -> _Float32: ...
    @property
    def residual(self) -> _Float32: ...
    @property
    def valid(self) -> _Bytes: ...
    @property
    def angles_rad(self) -> list[float]: ...
    @property
    def exposures(self) -> list[int]: ...

class ReflectionMap:
    @property
    def specular_share(self) -> float: ...
    @property
    def clamped_share(self) -> float: ...
    @property
    def label(self) -> _Bytes: ...
    @property
    def zenith_rad(self) -> _Float32: ...

_CameraValues = tuple[str, int, int, list[float], _Float64, _Float64]

def read_image_dn(path: str) -> tuple[_Float32, float]: ...
def read_intensity(path: str) -> _Float32: ...
def resect(
    names: list[str], points: NDArray[np.float64], pixels: NDArray[np.float64], camera: _CameraValues
) -> dict[str, Any]: ...
def image_size(path: str) -> tuple[int, int]: ...
def read_mask(path: str) -> _Bytes: ...
def write_png(path: str, image: _Bytes) -> None: ...

class ColmapModel:
    @staticmethod
    def read(folder: str) -> ColmapModel: ...
    def write(self, folder: str) -> None: ...
    def transform(self, scale: float, rotation: NDArray[np.float64], translation: NDArray[np.float64]) -> None: ...
    def refine(
        self,
        pictures: Mapping[str, _Float32 | str],
        preferred: str,
        freedom: dict[str, str],
        options: str,
        threads: int,
        log: Callable[[str, str], None] | None,
    ) -> dict[str, Any]: ...
    def images(self) -> dict[str, tuple[_CameraValues, int, int]]: ...
    def points(self) -> tuple[_Float64, _Float64, NDArray[np.int64]]: ...

def as_colmap_camera(camera: _CameraValues) -> tuple[_CameraValues, float]: ...
def undistorted(camera: _CameraValues) -> Camera: ...
def match_pairs(
    photos: list[_Bytes],
    pairs: list[tuple[int, int]],
    threads: int,
    progress: Callable[[str, float, str], None] | None,
) -> list[NDArray[np.uint32]]: ...
def epipolar_line(camera: _CameraValues, u: float, v: float, other: _CameraValues) -> list[tuple[float, float]]: ...
def quaternion_of(rotation: _Float64) -> list[float]: ...
def detect_targets(image: _Bytes, dictionary: str) -> list[tuple[int, float, float]]: ...
def adjust_datum(
    views: list[tuple[str, _CameraValues]],
    points: list[tuple[str, list[float], list[tuple[int, float, float, float]], bool]],
) -> dict[str, Any]: ...
def adjust_scale(
    views: list[tuple[str, _CameraValues]],
    distances: list[
        tuple[str, float, float, list[tuple[int, float, float, float]], list[tuple[int, float, float, float]], bool]
    ],
) -> dict[str, Any]: ...
def visual_hull(
    camera: _CameraValues,
    mask: _Bytes,
    silhouettes: list[tuple[str, _CameraValues]],
    threads: int,
    progress: Callable[[str, float, str], None] | None,
) -> tuple[_Float32, _Float32]: ...
def sweep_surface(
    intensity: _Float32,
    camera: _CameraValues,
    views: list[tuple[_Float32 | str, _CameraValues]],
    points: _Float64,
    surface: tuple[_Float32, _Float32] | None,
    mask: _Bytes,
    options: str,
    threads: int,
    progress: Callable[[str, float, str], None] | None,
    log: Callable[[str, str], None] | None,
) -> dict[str, Any]: ...

class StepWatch:
    def stop(self) -> str: ...

class DepthPrior:
    @property
    def camera(self) -> Camera: ...
    @property
    def points_total(self) -> float: ...
    @property
    def points_used(self) -> float: ...
    @property
    def noise(self) -> float: ...
    @property
    def spacing_px(self) -> float: ...
    @property
    def smoothing_px(self) -> float: ...
    @property
    def filled_fraction(self) -> float: ...
    def __init__(self, depth: _Float32, sigma: _Float32, camera: Camera) -> None: ...
    @property
    def depth(self) -> _Float32: ...
    @property
    def sigma(self) -> _Float32: ...

class HeightMap:
    @property
    def perspective(self) -> bool: ...
    @property
    def light(self) -> _Float64: ...
    @property
    def status(self) -> str: ...
    @property
    def residual_rms(self) -> float: ...
    @property
    def height(self) -> _Float32: ...

class FusedSurface:
    @property
    def camera(self) -> Camera: ...
    @property
    def method(self) -> str: ...
    @property
    def status(self) -> str: ...
    @property
    def warnings(self) -> list[str]: ...
    def __init__(
        self,
        depth: _Float32,
        normals: _Float32,
        sigma: _Float32,
        camera: Camera,
    ) -> None: ...
    @property
    def depth(self) -> _Float32: ...
    @property
    def normals(self) -> _Float32: ...
    @property
    def sigma(self) -> _Float32: ...
    @property
    def confidence(self) -> dict[str, Any]: ...

_Points = tuple[_Float64, NDArray[np.floating], NDArray[np.floating], NDArray[np.integer], NDArray[np.floating] | None]

class ObjectView:
    def __init__(
        self,
        name: str,
        gsd: float,
        camera: Camera,
        depth: _Float32,
        normals: _Float32,
        sigma: _Float32,
        cosine: _Float32,
        usable: _Bytes,
        object: _Bytes,
    ) -> None: ...
    @property
    def eye(self) -> _Float64: ...
    def points_at(self, rows: NDArray[np.integer], columns: NDArray[np.integer]) -> _Float64: ...
    def sights(
        self, points: _Float64, normals: _Float64, near_gsd: float
    ) -> tuple[NDArray[np.int32], NDArray[np.int32], _Float64]: ...
    def sees(self, points: _Float64, normals: _Float64) -> NDArray[np.bool_]: ...
    def resolves_more(self, other: ObjectView) -> bool: ...
    def finer(self, cosines: _Float64, other: ObjectView, other_cosines: _Float64) -> NDArray[np.bool_]: ...

def view_maps(surface: FusedSurface, most_sigma_gsd: float, threads: int) -> tuple[float, dict[str, Any]]: ...
def scales_of(gsds: Sequence[float]) -> list[float]: ...
def levels_of(scales: NDArray[np.floating]) -> NDArray[np.int64]: ...
def agreement_figures(distances: Sequence[tuple[_Float64, _Float64]], gsd: float) -> dict[str, float | None]: ...
def combine(
    views: Sequence[ObjectView], cloud: _Points | None, threads: int
) -> tuple[_Points, list[tuple[str, _Float32, _Float64, _Float64]]]: ...
def object_points(views: Sequence[ObjectView], clouds: Sequence[_Points], threads: int) -> _Points: ...
def unseen_stereo(cloud: _Points, views: Sequence[ObjectView], seen_points: _Points, threads: int) -> _Points: ...
def phase_maps(degree: _Float32, phase: _Float32) -> tuple[_Float32, _Float32]: ...
def is_telling(view: ObjectView, phases: _Float32, threads: int) -> bool: ...
def sharpened(
    view: ObjectView, stations: Sequence[tuple[ObjectView, _Float32]], threads: int
) -> tuple[_Float32, _Float32]: ...
def select_similar(picture: _Bytes, u: int, v: int, tolerance: int) -> _Bytes: ...
def cut_out_object(picture: _Bytes, hints: _Bytes, iterations: int, threads: int) -> _Bytes: ...
def demosaic(mosaic: _Float32, threads: int) -> list[_Float32]: ...
def demosaic_color(mosaic: _Float32, colors: str, threads: int) -> tuple[list[_Float32], list[_Float32]]: ...
def linearize(image: _Float32, response: str, black: float, white: float) -> _Float32: ...
def undistort(image: _Float32, camera: _CameraValues, threads: int) -> _Float32: ...
def fit_polarizer(
    images: Sequence[_Float32],
    nominal_rad: Sequence[float],
    mask: _Bytes,
    full_well_e: float,
    read_noise_e: float,
    frames_averaged: int,
    options: str,
    threads: int,
) -> dict[str, Any]: ...
def estimate_light(
    intensity: _Float32, normals: _Float32, mask: _Bytes, camera: Camera | None, options: str, threads: int
) -> dict[str, Any]: ...
def light_from_polarization(
    state: PolarizationState,
    reflection: ReflectionMap,
    direction: _Float64 | None,
    camera: Camera | None,
    options: str,
    threads: int,
) -> dict[str, Any]: ...
def register_images(
    images: Sequence[_Float32],
    options: str,
    frames_averaged: int,
    full_well_e: float,
    read_noise_e: float,
    threads: int,
) -> list[dict[str, Any]]: ...
def decompose(
    images: Sequence[_Float32],
    angles_rad: Sequence[float],
    mask: _Bytes,
    full_well_e: float,
    read_noise_e: float,
    frames_averaged: int,
    options: str,
    threads: int,
) -> PolarizationState: ...
def decompose_16_bit(
    images: Sequence[NDArray[np.uint16]],
    angles_rad: Sequence[float],
    mask: _Bytes,
    full_well_e: float,
    read_noise_e: float,
    frames_averaged: int,
    options: str,
    threads: int,
) -> PolarizationState: ...
def diffuse_degree(zenith_rad: _Float64, eta: float) -> _Float64: ...
def specular_degree(zenith_rad: _Float64, eta: float) -> _Float64: ...
def diffuse_zenith(degree: _Float64, eta: float) -> _Float64: ...
def specular_zenith(degree: _Float64, eta: float, above_brewster: bool) -> _Float64: ...
def brewster_angle(eta: float) -> float: ...
def map_reflection(
    state: PolarizationState,
    camera: Camera | None,
    normals: _Float32 | None,
    refractive_index: float,
    reflection: str,
    labels: _Bytes | None,
    options: str,
    threads: int,
) -> ReflectionMap: ...
def check_phase(state: PolarizationState, camera: Camera | None, normals: _Float32, threads: int) -> dict[str, Any]: ...
def check_cloud(
    points: _Float64,
    normals: _Float32 | None,
    colors: _Bytes | None,
    state: PolarizationState,
    scene: _Float32 | None,
    mask: _Bytes,
    camera: Camera,
    unit: str,
    threads: int,
) -> dict[str, Any]: ...
def check_depth(
    depth: _Float32,
    state: PolarizationState,
    scene: _Float32 | None,
    mask: _Bytes,
    camera: Camera,
    unit: str,
    threads: int,
) -> dict[str, Any]: ...
def check_order(images: Sequence[_Float32], angles_rad: Sequence[float], mask: _Bytes) -> dict[str, Any]: ...
def check_response(
    images: Sequence[_Float32], angles_rad: Sequence[float], mask: _Bytes, response: str
) -> dict[str, Any]: ...
def check_size(points_in_cam: _Float64, camera: Camera, unit: str) -> dict[str, Any]: ...
def angle_of_name(file: Any, pattern: str, where: str) -> float: ...
def angles_of_names(files: Sequence[Any], where: str, instead: str) -> list[float]: ...
def project_points(
    points: _Float64,
    normals: _Float32 | None,
    camera: Camera,
    mask: _Bytes,
    options: str,
    threads: int,
) -> DepthPrior: ...
def project_mesh(
    vertices: _Float64,
    triangles: NDArray[np.uint32],
    camera: Camera,
    mask: _Bytes,
    options: str,
    threads: int,
) -> DepthPrior: ...
def project_depth(depth: _Float32, camera: Camera, mask: _Bytes, options: str, threads: int) -> DepthPrior: ...
def project_swept(
    depth: _Float32,
    sigma: _Float32,
    surface: _Float32 | None,
    camera: Camera,
    mask: _Bytes,
    options: str,
    threads: int,
) -> DepthPrior: ...
def project_shape(shape: str, sigma: float, camera: Camera, mask: _Bytes, options: str, threads: int) -> DepthPrior: ...
def solve_height(
    state: PolarizationState,
    reflection: ReflectionMap,
    camera: Camera | None,
    light: _Float64 | None,
    normals: _Float32 | None,
    depth: _Float32 | None,
    options: str,
    threads: int,
) -> HeightMap: ...
def calibrate_with_surface(
    state: PolarizationState,
    camera: Camera | None,
    normals: _Float32,
    light: _Float64 | None,
    known_scale: bool,
    reflection: str,
    refractive_index: float,
    options: str,
    threads: int,
) -> tuple[PolarizationState, dict[str, Any]]: ...
def fuse_grid(height: HeightMap, prior: DepthPrior, options: str, threads: int) -> FusedSurface: ...
def optimize_grid(
    surface: FusedSurface,
    state: PolarizationState,
    reflection: ReflectionMap,
    prior: DepthPrior,
    height: HeightMap,
    options: str,
    threads: int,
) -> FusedSurface: ...
def refine(
    state: PolarizationState,
    prior: DepthPrior,
    refractive_index: float | None,
    reflection: str,
    labels: _Bytes | None,
    metal: str,
    options: str,
    threads: int,
) -> FusedSurface: ...
def normals_from_depth(depth: _Float32, camera: Camera, threads: int) -> _Float32: ...
def mesh_from_depth(surface: FusedSurface, color: _Float32 | None, options: str, threads: int) -> dict[str, Any]: ...
def tangent_plane_mean(
    at: _Float64, normals: _Float64, reach: _Float64, first: Sequence[int], side: int, least_weight: float, threads: int
) -> _Float32: ...
def display_image(color: _Float32, depth: _Float32, white_percentile: float) -> _Bytes: ...
def dem_from_mesh(
    vertices: _Float64, triangles: NDArray[np.uint32], surface: FusedSurface, options: str, threads: int
) -> dict[str, Any]: ...
def write_dem(
    path: str,
    elevation: _Float32,
    pixel: float,
    origin: _Float64,
    right: _Float64,
    up: _Float64,
    normal: _Float64,
    unit: str,
    name: str,
) -> None: ...
def write_ply(
    path: str,
    vertices: _Float64,
    normals: _Float32,
    colors: _Bytes,
    triangles: NDArray[np.uint32],
    comments: list[str],
    threads: int,
) -> None: ...
def write_glb(
    path: str,
    vertices: _Float64,
    normals: _Float32,
    triangles: NDArray[np.uint32],
    texture: _Bytes,
    camera: Camera,
    unit: str,
    name: str,
    extras: str,
    threads: int,
) -> None: ...
def section(
    start: tuple[float, float],
    end: tuple[float, float],
    surface: _Float32,
    prior: _Float32 | None,
    camera: Camera,
    gsd: float,
    options: str,
) -> dict[str, Any]: ...
def compare_with_reference(
    surface: FusedSurface,
    vertices: _Float64,
    triangles: NDArray[np.uint32] | None,
    gsd: float,
    options: str,
    threads: int,
) -> dict[str, Any]: ...
def align_with_reference(
    points: _Float64,
    vertices: _Float64,
    triangles: NDArray[np.uint32] | None,
    gsd: float,
    options: str,
    threads: int,
) -> dict[str, Any]: ...
def distances_from_reference(
    points: _Float64,
    normals: _Float64,
    vertices: _Float64,
    triangles: NDArray[np.uint32] | None,
    gsd: float,
    options: str,
    threads: int,
    with_beside: bool,
) -> NDArray[np.float32]: ...
def fit_patch(
    depth: _Float32, camera: Camera, x0: int, y0: int, x1: int, y1: int, gsd: float
) -> dict[str, float] | None: ...
