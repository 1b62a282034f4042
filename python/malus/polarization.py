"""Polarization of light: sinusoid fit, Fresnel degrees and zeniths, reflection labels.

Angles are counter-clockwise from image +x as displayed; I(a) = i_un (1 + rho cos 2(a - phi)). See docs/conventions.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from malus import _core
from malus._arrays import (
    as_angles,
    as_image,
    as_intensities,
    as_mask,
    as_numbers,
    as_reflection,
    as_shares,
    as_zeniths,
    require_noise,
)
from malus._core import PolarizationState, ReflectionMap
from malus.camera import Camera, require_view
from malus.options import Options
from malus.threads import ALL_CORES

__all__ = [
    "PolarizationState",
    "ReflectionMap",
    "brewster_angle",
    "calibrate",
    "calibrate_with_surface",
    "decompose",
    "diffuse_degree",
    "diffuse_zenith",
    "map_reflection",
    "specular_degree",
    "specular_zenith",
]


def calibrate(
    images: Sequence[ArrayLike] | NDArray[Any],
    angles_rad: Sequence[float] | NDArray[Any] = (),
    *,
    mask: ArrayLike | None = None,
    full_well_e: float = 20000.0,
    read_noise_e: float = 8.0,
    frames_averaged: int = 1,
    options: Options | None = None,
    threads: int = ALL_CORES,
) -> dict[str, Any]:
    """Polarizer angles and relative exposures for which K registered linear images fit sinusoids best.

    images: as for `decompose`. angles_rad: as read off the scale; empty = unknown, which needs five images or more. Returns
    `angles_rad`, `gains` (geometric mean 1), `residual_before` and `residual_after` (RMS, in standard deviations of the
    noise) and `improvement`: of the squared residuals beyond noise, the share that the calibration removes. Images do not
    determine the polarizer zero (docs/method.md, section 1). Raises ValueError as `decompose` does.
    """
    require_noise(full_well_e, read_noise_e, frames_averaged)
    stack = as_shares(images, "images")
    return _core.fit_polarizer(
        stack,
        as_angles(angles_rad, "angles_rad", len(stack) if len(angles_rad) else None),
        as_mask(mask, stack[0].shape),
        full_well_e,
        read_noise_e,
        frames_averaged,
        (options or Options()).to_json(),
        threads,
    )


def calibrate_with_surface(
    state: PolarizationState,
    normals: ArrayLike,
    *,
    camera: Camera | None = None,
    light: ArrayLike | None = None,
    known_scale: bool = True,
    reflection: str = "auto",
    refractive_index: float = 1.5,
    options: Options | None = None,
    threads: int = ALL_CORES,
) -> tuple[PolarizationState, dict[str, Any]]:
    """Zero of the polarizer's scale, which images alone do not determine, by the azimuths of a surface (docs/method.md, section 1).

    normals: H×W×3, unit, camera frame, towards the camera, NaN = none. camera None = orthographic. light: 3, camera frame, towards the
    source, as `malus.height.light` finds it, if there is a highlight. known_scale False: zero and direction are not known at all.
    reflection: "auto", "diffuse" or "specular". Returns the state, corrected where the option polarizer.calibrate_angles allows and the
    zero is significantly off, and figures: `from_surface` (whether it is corrected), `surface_check`, `angles_deg` and
    `angles_sigma_deg` of the state's distinct angles, `zero_error_deg` (to be added to angles as read), `zero_error_sigma_deg`,
    `coherence`, `coherence_opposite`, `warnings` and others.

    Raises ValueError for wrong shapes; malus.InputError if the scale certainly counts the other way or is off by 90°; malus.DataError if
    the scale is not known and the surface does not determine it.
    """
    require_view(camera, state.unpolarized.shape, "the state")
    surface = as_image(normals, "normals", 3)
    if surface.shape[:2] != state.unpolarized.shape:
        raise ValueError(f"normals has shape {surface.shape}, expected {(*state.unpolarized.shape, 3)} as the state")
    direction = None
    if light is not None:
        direction = _plain(light, "light")
        if direction.shape != (3,) or not np.linalg.norm(direction) > 0:
            raise ValueError(f"light is {direction.tolist()}, expected three numbers that are not all zero")
    return _core.calibrate_with_surface(
        state,
        camera,
        surface,
        direction,
        known_scale,
        reflection,
        refractive_index,
        (options or Options()).to_json(),
        threads,
    )


def decompose(
    images: Sequence[ArrayLike] | NDArray[Any],
    angles_rad: Sequence[float] | NDArray[Any],
    *,
    mask: ArrayLike | None = None,
    full_well_e: float = 20000.0,
    read_noise_e: float = 8.0,
    frames_averaged: int = 1,
    options: Options | None = None,
    threads: int = ALL_CORES,
) -> PolarizationState:
    """Fit I(a) = (s0 + s1 cos 2a + s2 sin 2a) / 2 at every pixel.

    images: K arrays H×W, linear, in [0, 1] of the white level, or all uint16 with white at 65535. angles_rad: K polarizer
    angles; images with the same angle (modulo π) count as repeated exposures. mask: H×W, non-zero = object. The noise
    model (electrons at white, read noise, averaged frames) sets the expected residual. Returns a state with `unpolarized` = s0 / 2,
    `degree`, `phase_rad` in [0, π), `residual` (in expected standard deviations) and `valid` (255 = usable), all H×W, read-only.
    float32 and uint16 images in C order are used without a copy.
    Raises ValueError for wrong shapes, angles in degrees, intensities of another scale and impossible noise, malus.DataError for
    fewer than three distinct angles.
    """
    require_noise(full_well_e, read_noise_e, frames_averaged)
    stack = as_intensities(images, "images")
    fit = _core.decompose_16_bit if stack[0].dtype == np.uint16 else _core.decompose
    return fit(
        stack,
        as_angles(angles_rad, "angles_rad", len(stack)),
        as_mask(mask, stack[0].shape),
        full_well_e,
        read_noise_e,
        frames_averaged,
        (options or Options()).to_json(),
        threads,
    )


def _plain(values: ArrayLike, name: str) -> NDArray[np.float64]:
    return np.asarray(as_numbers(values, name), dtype=np.float64)


def diffuse_degree(zenith_rad: ArrayLike, refractive_index: float = 1.5) -> NDArray[np.float64]:
    """Degree of linear polarization of diffuse reflection (Eq 6), any shape. InputError unless the index is from 1.05 to 3;
    ValueError for angles in degrees."""
    return _core.diffuse_degree(as_zeniths(zenith_rad, "zenith_rad"), refractive_index)


def specular_degree(zenith_rad: ArrayLike, refractive_index: float = 1.5) -> NDArray[np.float64]:
    """Degree of linear polarization of specular reflection (Eq 8), any shape. Raises the errors of `diffuse_degree`."""
    return _core.specular_degree(as_zeniths(zenith_rad, "zenith_rad"), refractive_index)


def diffuse_zenith(degree: ArrayLike, refractive_index: float = 1.5) -> NDArray[np.float64]:
    """Zenith [rad] of a diffuse degree (Eq 7); degrees above the largest possible degree give 90°."""
    return _core.diffuse_zenith(_plain(degree, "degree"), refractive_index)


def specular_zenith(
    degree: ArrayLike, refractive_index: float = 1.5, *, above_brewster: bool = False
) -> NDArray[np.float64]:
    """Zenith [rad] of a specular degree (inverse of Eq 8) on one side of Brewster's angle."""
    return _core.specular_zenith(_plain(degree, "degree"), refractive_index, above_brewster)


def brewster_angle(refractive_index: float = 1.5) -> float:
    """Brewster's angle [rad]."""
    return _core.brewster_angle(refractive_index)


def map_reflection(
    state: PolarizationState,
    *,
    camera: Camera | None = None,
    prior_normals: ArrayLike | None = None,
    refractive_index: float = 1.5,
    reflection: str | ArrayLike = "auto",
    options: Options | None = None,
    threads: int = ALL_CORES,
) -> ReflectionMap:
    """Label pixels diffuse (1) or specular (2) and compute their zenith from the degree.

    camera None = orthographic. prior_normals: H×W×3, unit, camera frame, towards the camera; they decide between diffuse
    and specular and pick the side of Brewster's angle. reflection: "auto", "diffuse", "specular", or labels H×W (1 = diffuse,
    2 = specular, 0 = decide). Returns `label` (H×W uint8, 0 = outside) and `zenith_rad` (H×W, NaN = none).
    """
    require_view(camera, state.unpolarized.shape, "the state")
    normals = None if prior_normals is None else as_image(prior_normals, "prior_normals", 3)
    name, labels = as_reflection(reflection, state.degree.shape)
    return _core.map_reflection(
        state, camera, normals, refractive_index, name, labels, (options or Options()).to_json(), threads
    )
