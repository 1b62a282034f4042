"""Checks of images, prior and polarizer against each other, which find wrong inputs before anything is fused.

Every check returns a Finding. Its severity is "error" (the input is certainly wrong), "warning" (a person should look at it),
"caution" (the input is right, but parts of the result are worse for it) or "note" (either no fault was found, or the data
cannot decide; the message says which).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from malus import _core
from malus._arrays import as_angles, as_colors, as_image, as_mask, as_rows, as_shares
from malus._core import PolarizationState
from malus.camera import Camera, require_view
from malus.threads import ALL_CORES

__all__ = [
    "Finding",
    "OrderFinding",
    "PhaseFinding",
    "PriorFinding",
    "check_cloud",
    "check_depth",
    "check_order",
    "check_phase",
    "check_response",
    "check_size",
]


@dataclass(frozen=True)
class Finding:
    """What a check concluded.

    check: which check ("phase", "prior", "size", "order", "response"); severity: "note", "caution", "warning" or "error"; message and
    suggestion: for people; figures: the numbers on which the message is based, by name.
    """

    check: str
    severity: str
    message: str
    suggestion: str
    figures: dict[str, float]


@dataclass(frozen=True)
class PhaseFinding(Finding):
    """parts: 6×6×4, for each part of the image, row by row: mean u, v [px] of the pixels compared, disagreement (root mean square of
    sin 2(phase − azimuth): 0 = agrees with the prior, 0.71 = unrelated; NaN = too few pixels), and its standard deviation."""

    parts: NDArray[np.float64]


@dataclass(frozen=True)
class PriorFinding(Finding):
    """instead: an assumption that fits better than the input as given ("the images are turned by 180°"); "" = none found."""

    instead: str


@dataclass(frozen=True)
class OrderFinding(Finding):
    """angles_rad: one per image, in the order that fits best; the given angles if no other order is clearly better."""

    angles_rad: list[float]


def check_phase(
    state: PolarizationState, normals: ArrayLike, *, camera: Camera | None = None, threads: int = ALL_CORES
) -> PhaseFinding:
    """Check whether the phases of polarization agree with the azimuths of a surface, for diffuse and specular reflection alike.

    normals: H×W×3, unit, camera frame, towards the camera, NaN = none. camera None = orthographic. exp(4i phase) is compared
    with exp(4i azimuth), because the two are equal for diffuse and for specular reflection. Each place is weighted by the
    uncertainty of its phase (noise over degree) and of its azimuth (0.15 over slope).
    """
    require_view(camera, state.unpolarized.shape, "the state")
    return PhaseFinding(**_core.check_phase(state, camera, as_image(normals, "normals", 3), threads))


def _scene_and_mask(
    state: PolarizationState, camera: Camera, scene: ArrayLike | None, mask: ArrayLike | None
) -> tuple[NDArray[Any] | None, NDArray[np.uint8]]:
    shape = state.unpolarized.shape
    require_view(camera, shape, "the state")
    image = None if scene is None else as_image(scene, "scene")
    if image is not None and image.shape != shape:
        raise ValueError(f"scene has shape {image.shape}, expected {shape}")
    return image, as_mask(mask, shape)


def check_cloud(
    points: ArrayLike,
    state: PolarizationState,
    camera: Camera,
    *,
    normals: ArrayLike | None = None,
    colors: ArrayLike | None = None,
    scene: ArrayLike | None = None,
    mask: ArrayLike | None = None,
    unit: str = "mm",
    threads: int = ALL_CORES,
) -> PriorFinding:
    """Check whether a cloud lies where the images show the object.

    points, normals: N×3, world frame; colors: N×3, 0 to 255. camera: with its pose. scene: H×W unpolarized intensity of
    everything in view (without it only the state's valid pixels are used). mask: H×W, non-zero = object.

    The check compares colors with brightness, and azimuths of the normals with phases. If neither correlates, it compares edges
    of the cloud (where its surface bends) with edges of the image. It searches shifts up to 8 % of the object, turns in the
    image up to 5° and changes of size up to 8 %, images that were turned or mirrored, and inverted masks. If the cloud misses
    the object or has nothing in common with the images, it also tries other units, exchanged or negated axes, and inverted
    poses.
    """
    cloud = as_rows(points, "points")
    image, object_mask = _scene_and_mask(state, camera, scene, mask)
    return PriorFinding(
        **_core.check_cloud(
            cloud,
            None if normals is None else as_rows(normals, "normals", len(cloud), np.float32),
            None if colors is None else as_colors(colors, "colors", len(cloud)),
            state,
            image,
            object_mask,
            camera,
            unit,
            threads,
        )
    )


def check_depth(
    depth: ArrayLike,
    state: PolarizationState,
    camera: Camera,
    *,
    scene: ArrayLike | None = None,
    mask: ArrayLike | None = None,
    unit: str = "mm",
    threads: int = ALL_CORES,
) -> PriorFinding:
    """As `check_cloud`, for a depth map in the station's view (H×W, z, NaN = none), which has no colors."""
    image, object_mask = _scene_and_mask(state, camera, scene, mask)
    return PriorFinding(**_core.check_depth(as_image(depth, "depth"), state, image, object_mask, camera, unit, threads))


def check_size(points_in_cam: ArrayLike, camera: Camera, *, unit: str = "mm") -> Finding:
    """State size and distance of the object in words; if they are implausible, warn and name the likelier unit.

    points_in_cam: N×3, of the object, camera frame, N > 0, without NaN.
    """
    points = as_rows(points_in_cam, "points_in_cam")
    if not np.isfinite(points).all():
        raise ValueError("points_in_cam has numbers that are not finite, expected only pixels with a depth")
    return Finding(**_core.check_size(points, camera, unit))


def check_order(
    images: Sequence[ArrayLike] | NDArray[Any],
    angles_rad: Sequence[float] | NDArray[Any],
    *,
    mask: ArrayLike | None = None,
) -> OrderFinding:
    """Check whether the images are in the order of their angles, by how well each pixel follows the sinusoid.

    images: K arrays H×W, linear, in [0, 1], or all uint16 with white at 65535. A warning if another order leaves a quarter
    of the squared residuals or less. Orders that fit equally well cannot be distinguished: those of three angles, and those
    of equally spaced angles that are all shifted or counted in the opposite direction.
    """
    stack = as_shares(images, "images")
    return OrderFinding(
        **_core.check_order(stack, as_angles(angles_rad, "angles_rad", len(stack)), as_mask(mask, stack[0].shape))
    )


def check_response(
    images: Sequence[ArrayLike] | NDArray[Any],
    angles_rad: Sequence[float] | NDArray[Any],
    *,
    mask: ArrayLike | None = None,
    response: str = "linear",
) -> Finding:
    """Check whether images linearized by `response` (K arrays H×W as for `check_order`, K > 3) are linear in the light.

    A response curve distorts the sinusoid: figures["bend"] is the factor of I ρ² cos 4(a − φ), 0 for linear images, −0.30 for
    encoded images taken as linear, 0.14 for linear images decoded as sRGB.
    """
    stack = as_shares(images, "images")
    return Finding(
        **_core.check_response(
            stack, as_angles(angles_rad, "angles_rad", len(stack)), as_mask(mask, stack[0].shape), response
        )
    )
