"""Types of the private extension; see the package's own modules for documentation."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Bytes = NDArray[np.uint8]

version: str

def option_schema() -> str: ...
def default_options() -> str: ...
def check_options(json: str) -> str: ...
def set_option(json: str, assignment: str) -> str: ...
def options_from_file(json: str, path: str) -> str: ...
def step_names() -> list[str]: ...
def describe_run(options: str, until: str | None) -> list[tuple[str, str, list[str]]]: ...
def claim_workspace(folder: str, station: Station, replace: bool) -> None: ...
def read_manifest(folder: str) -> str: ...
def sha256_of_file(path: str) -> str: ...
def forget_step(folder: str, step: str) -> None: ...
def record_step(folder: str, step: str, files: list[str], seconds: float) -> None: ...
def read_raster(path: str) -> Float32: ...
def read_points(path: str) -> Float64: ...
def write_float_tiff(path: str, image: Float32) -> None: ...
def write_png16(path: str, image: NDArray[np.uint16]) -> None: ...
def write_tiff16(path: str, image: NDArray[np.uint16]) -> None: ...

class Station:
    @staticmethod
    def load(path: str) -> Station: ...
    @staticmethod
    def from_arrays(**values: Any) -> Station: ...
    def describe(self) -> str: ...
    def with_developed(self, images: list[str], full_well_e: float | None, read_noise_e: float | None) -> Station: ...
    def with_file_doubts(self, doubts: list[tuple[str, str]]) -> Station: ...
    def with_cloud(self, points: Float64, normals: Float32 | None) -> Station: ...
    def with_photogrammetry(
        self,
        camera: CameraValues,
        prior_depth: Float32 | None,
        prior_sigma: Float32 | None,
        prior_shape: Float32 | None,
        figures: str,
        times: str,
        warnings: list[str],
    ) -> Station: ...

class Results: ...

def reconstruct(
    station: Station,
    options: str,
    workspace: str | None,
    replace: bool,
    until: str | None,
    reference: str | None,
    keep_maps: bool,
    known: Results | None,
    threads: int,
    progress: Callable[[str, float, str], None] | None,
    log: Callable[[str, str], None] | None,
) -> dict[str, Any]: ...
def check(station: Station, options: str, threads: int) -> str: ...
def check_picture(station: Station, threads: int) -> tuple[Float32, Bytes, Float32]: ...

class Pinhole:
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    def __init__(self, width: int, height: int, fx: float, fy: float, cx: float, cy: float) -> None: ...

class PolarizationState:
    @property
    def unpolarized(self) -> Float32: ...
    @property
    def degree(self) -> Float32: ...
    @property
    def phase_rad(self) -> Float32: ...
    @property
    def residual(self) -> Float32: ...
    @property
    def valid(self) -> Bytes: ...
    @property
    def angles_rad(self) -> list[float]: ...
    @property
    def exposures(self) -> list[int]: ...

class ReflectionMap:
    specular_share: float
    clamped_share: float
    @property
    def label(self) -> Bytes: ...
    @property
    def zenith_rad(self) -> Float32: ...

CameraValues = tuple[str, int, int, list[float], Float64, Float64]

def read_image_dn(path: str) -> tuple[Float32, float]: ...
def image_size(path: str) -> tuple[int, int]: ...
def write_png(path: str, image: Bytes) -> None: ...

class ColmapModel:
    @staticmethod
    def read(folder: str) -> ColmapModel: ...
    def write(self, folder: str) -> None: ...
    def scale(self, factor: float) -> None: ...
    def refine(
        self,
        pictures: dict[str, Float32],
        preferred: str,
        freedom: dict[str, str],
        options: str,
        threads: int,
        log: Callable[[str, str], None] | None,
    ) -> dict[str, Any]: ...
    def images(self) -> dict[str, tuple[CameraValues, int, int]]: ...
    def points(self) -> tuple[Float64, Float64, NDArray[np.int64]]: ...

def as_colmap_camera(camera: CameraValues) -> tuple[CameraValues, float]: ...
def pinhole_of(camera: CameraValues) -> Pinhole: ...
def match_pairs(
    photos: list[Bytes],
    pairs: list[tuple[int, int]],
    threads: int,
    progress: Callable[[str, float, str], None] | None,
) -> list[NDArray[np.uint32]]: ...
def target_dictionaries() -> list[str]: ...
def detect_targets(image: Bytes, dictionary: str) -> list[tuple[int, float, float]]: ...
def adjust_scale(
    views: list[tuple[str, CameraValues]],
    distances: list[
        tuple[str, float, float, list[tuple[int, float, float, float]], list[tuple[int, float, float, float]], bool]
    ],
) -> dict[str, Any]: ...
def sweep_surface(
    intensity: Float32,
    camera: CameraValues,
    views: list[tuple[Float32, CameraValues]],
    points: Float64,
    surface: tuple[Float32, Float32] | None,
    mask: Bytes | None,
    options: str,
    threads: int,
    progress: Callable[[str, float, str], None] | None,
    log: Callable[[str, str], None] | None,
) -> dict[str, Any]: ...

class DepthPrior:
    camera: Pinhole
    points_total: float
    points_used: float
    noise: float
    spacing_px: float
    smoothing_px: float
    filled_fraction: float
    def __init__(
        self, depth: Float32, sigma: Float32, camera: Pinhole, rotation: Float64, translation: Float64
    ) -> None: ...
    @property
    def depth(self) -> Float32: ...
    @property
    def sigma(self) -> Float32: ...

class HeightMap:
    perspective: bool
    light: Float64
    status: str
    residual_rms: float
    @property
    def height(self) -> Float32: ...

class FusedSurface:
    camera: Pinhole
    method: str
    status: str
    warnings: list[str]
    def __init__(
        self,
        depth: Float32,
        normals: Float32,
        sigma: Float32,
        camera: Pinhole,
        rotation: Float64,
        translation: Float64,
    ) -> None: ...
    @property
    def depth(self) -> Float32: ...
    @property
    def normals(self) -> Float32: ...
    @property
    def sigma(self) -> Float32: ...

def demosaic(mosaic: Float32, threads: int) -> list[Float32]: ...
def demosaic_color(mosaic: Float32, colors: str, threads: int) -> tuple[list[Float32], list[Float32]]: ...
def register_images(
    images: Sequence[Float32], options: str, frames_averaged: int, full_well_e: float, read_noise_e: float, threads: int
) -> list[dict[str, Any]]: ...
def decompose(
    images: Sequence[Float32],
    angles_rad: Sequence[float],
    mask: Bytes | None,
    full_well_e: float,
    read_noise_e: float,
    frames_averaged: int,
    options: str,
    threads: int,
) -> PolarizationState: ...
def decompose_16_bit(
    images: Sequence[NDArray[np.uint16]],
    angles_rad: Sequence[float],
    mask: Bytes | None,
    full_well_e: float,
    read_noise_e: float,
    frames_averaged: int,
    options: str,
    threads: int,
) -> PolarizationState: ...
def diffuse_degree(zenith_rad: Float64, eta: float) -> Float64: ...
def specular_degree(zenith_rad: Float64, eta: float) -> Float64: ...
def diffuse_zenith(degree: Float64, eta: float) -> Float64: ...
def specular_zenith(degree: Float64, eta: float, above_brewster: bool) -> Float64: ...
def brewster_angle(eta: float) -> float: ...
def map_reflection(
    state: PolarizationState,
    camera: Pinhole | None,
    normals: Float32 | None,
    refractive_index: float,
    reflection: str,
    options: str,
    threads: int,
) -> ReflectionMap: ...
def check_phase(state: PolarizationState, camera: Pinhole | None, normals: Float32, threads: int) -> dict[str, Any]: ...
def check_cloud(
    points: Float64,
    normals: Float32 | None,
    colors: Bytes | None,
    rotation: Float64,
    translation: Float64,
    state: PolarizationState,
    scene: Float32 | None,
    mask: Bytes | None,
    camera: Pinhole,
    unit: str,
    threads: int,
) -> dict[str, Any]: ...
def check_depth(
    depth: Float32,
    state: PolarizationState,
    scene: Float32 | None,
    mask: Bytes | None,
    camera: Pinhole,
    unit: str,
    threads: int,
) -> dict[str, Any]: ...
def check_order(images: Sequence[Float32], angles_rad: Sequence[float], mask: Bytes | None) -> dict[str, Any]: ...
def check_response(
    images: Sequence[Float32], angles_rad: Sequence[float], mask: Bytes | None, response: str
) -> dict[str, Any]: ...
def check_size(points_in_cam: Float64, camera: Pinhole, unit: str) -> dict[str, Any]: ...
def angles_of_names(files: Sequence[Any], where: str, instead: str) -> list[float]: ...
def project_points(
    points: Float64,
    camera: Pinhole,
    rotation: Float64,
    translation: Float64,
    mask: Bytes | None,
    options: str,
    threads: int,
) -> DepthPrior: ...
def solve_height(
    state: PolarizationState,
    reflection: ReflectionMap,
    camera: Pinhole | None,
    light: Float64 | None,
    normals: Float32 | None,
    options: str,
    threads: int,
) -> HeightMap: ...
def fuse_grid(height: HeightMap, prior: DepthPrior, options: str, threads: int) -> FusedSurface: ...
def refine(
    state: PolarizationState, prior: DepthPrior, refractive_index: float | None, options: str, threads: int
) -> FusedSurface: ...
def normals_from_depth(depth: Float32, camera: Pinhole, threads: int) -> Float32: ...
def mesh_from_depth(surface: FusedSurface, color: Float32 | None, options: str, threads: int) -> dict[str, Any]: ...
def display_image(color: Float32, depth: Float32, white_percentile: float) -> Bytes: ...
def dem_from_mesh(
    vertices: Float64, triangles: NDArray[np.uint32], surface: FusedSurface, options: str, threads: int
) -> dict[str, Any]: ...
def write_dem(
    path: str,
    elevation: Float32,
    pixel: float,
    origin: Float64,
    right: Float64,
    up: Float64,
    normal: Float64,
    unit: str,
    name: str,
) -> None: ...
def write_ply(
    path: str, vertices: Float64, normals: Float32, colors: Bytes, triangles: NDArray[np.uint32], threads: int
) -> None: ...
def write_glb(
    path: str,
    vertices: Float64,
    normals: Float32,
    triangles: NDArray[np.uint32],
    texture: Bytes,
    camera: Pinhole,
    rotation: Float64,
    translation: Float64,
    unit: str,
    name: str,
    threads: int,
) -> None: ...
def fit_patch(
    depth: Float32, camera: Pinhole, x0: int, y0: int, x1: int, y1: int, gsd: float
) -> dict[str, float] | None: ...
