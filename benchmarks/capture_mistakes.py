"""Mistakes of a person at the camera or while exporting, made on a copy of a station's files.

Images at another polarizer angle follow from the sinusoid that is fitted to the images: the change of the sinusoid is
added to each image, so that the image keeps its noise.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from mistakes import Inputs
from numpy.typing import NDArray
from rendered_files import Array, Cloud
from scipy import ndimage
from scipy.spatial.transform import Rotation

import malus


def random() -> np.random.Generator:
    """A generator with a fixed seed: every mistake is the same on every station and in every run."""
    return np.random.default_rng(3)


def harmonics(angles: Array) -> Array:
    return np.stack([np.ones_like(angles), np.cos(2 * angles), np.sin(2 * angles)], -1) / 2


def stokes(inputs: Inputs) -> Array:
    """s0, s1, s2 fitted to the images, 3×H×W."""
    flat = inputs.images.reshape(len(inputs.images), -1)
    found: Array = np.linalg.lstsq(harmonics(inputs.angles), flat, rcond=None)[0]
    return found.reshape(3, *inputs.images.shape[1:])


def taken_at(inputs: Inputs, angles: Array) -> Inputs:
    """Images at these angles; the angles in the station file are unchanged."""
    change = harmonics(angles) - harmonics(inputs.angles)
    return replace(inputs, images=inputs.images + np.tensordot(change, stokes(inputs), 1).astype(np.float32))


def each(inputs: Inputs, change: Callable[[Array, int], Array], frames: range | None = None) -> Inputs:
    """Inputs with all images, or those numbered in `frames`, changed by a function of image and number."""
    chosen = range(len(inputs.images)) if frames is None else frames
    images = [change(image, k) if k in chosen else image for k, image in enumerate(inputs.images)]
    return replace(inputs, images=np.stack(images).astype(np.float32))


def warped(image: Array, u: Array, v: Array) -> Array:
    """The image's values at these places."""
    return np.asarray(ndimage.map_coordinates(image, [v, u], order=3, mode="nearest"))


def places(
    image: Array, zoom: float = 1, degrees: float = 0, shift: tuple[float, float] = (0, 0)
) -> tuple[Array, Array]:
    """For each pixel of an image that is enlarged, turned and moved: its place u, v in the original image."""
    height, width = image.shape
    v, u = np.indices(image.shape, float)
    x, y = u - width / 2, v - height / 2
    angle = np.deg2rad(degrees)
    x, y = np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y
    return x / zoom + width / 2 + shift[0], y / zoom + height / 2 + shift[1]


def enlarged(inputs: Inputs, zoom: float) -> Inputs:
    """All images and the mask cropped, then resized to their former size."""
    u, v = places(inputs.images[0], zoom)
    mask = np.where(warped(inputs.mask.astype(float), u, v) > 127, 255, 0).astype(np.uint8)
    return replace(each(inputs, lambda image, _: warped(image, u, v)), mask=mask)


def distorted(inputs: Inputs) -> Inputs:
    """Barrel distortion of 2 % at the corners, which is missing in the station file."""
    height, width = inputs.images.shape[1:]
    u, v = places(inputs.images[0])
    x, y = (u - width / 2) / (width / 2), (v - height / 2) / (width / 2)
    factor = 1 + 0.02 * (x**2 + y**2) / (1 + (height / width) ** 2)
    u, v = x * factor * width / 2 + width / 2, y * factor * width / 2 + height / 2
    mask = np.where(warped(inputs.mask.astype(float), u, v) > 127, 255, 0).astype(np.uint8)
    return replace(each(inputs, lambda image, _: warped(image, u, v)), mask=mask)


def second_lamp(inputs: Inputs) -> Inputs:
    """From the fourth image on, a lamp beside the object makes the images brighter, from 0 on the left to 60 % on the right."""
    width = inputs.images.shape[2]
    return each(inputs, lambda image, _: image * (1 + 0.6 * np.arange(width) / width), range(3, len(inputs.images)))


def auto_exposure(inputs: Inputs) -> Inputs:
    """The camera gives every image the same mean on the object."""
    means = inputs.images[:, inputs.mask > 0].mean(axis=1)
    return each(inputs, lambda image, k: image * (means[0] / means[k]))


def auto_white_balance(inputs: Inputs) -> Inputs:
    """Color images whose gains of red and blue change from image to image, by up to 10 %."""
    gains = 1 + 0.1 * random().uniform(-1, 1, (len(inputs.images), 3)) * [1, 0, 1]
    return replace(inputs, images=(inputs.images[..., None] * gains[:, None, None]).astype(np.float32))


def picture_style(inputs: Inputs) -> Inputs:
    """8-bit JPEG as cameras write it: sharpened, with a tone curve; the station file states sRGB."""

    def styled(image: Array, _: int) -> Array:
        sharp = np.clip(image + 0.8 * (image - ndimage.gaussian_filter(image, 1.2)), 0, 1)
        return np.asarray(0.5 * sharp + 0.5 * sharp**2 * (3 - 2 * sharp))

    return replace(each(inputs, styled), jpeg=90)


def circular_filter(inputs: Inputs) -> Inputs:
    """The quarter-wave plate is in front: half of the light passes, at every angle; the noise level does not change."""
    half = stokes(inputs)[0] / 2
    left = inputs.images - np.tensordot(harmonics(inputs.angles), stokes(inputs), 1)
    share = (left**2).sum() / max(len(left) - 3, 1) / half.sum()
    noise = random().standard_normal(left.shape) * np.sqrt(share * np.maximum(half, 0))
    return replace(inputs, images=(half + noise).astype(np.float32))


def weak_filter(inputs: Inputs) -> Inputs:
    """A filter film that lets a fifth of the crossed light through: degrees of polarization fall to two thirds."""
    measured = stokes(inputs)
    lost = np.tensordot(harmonics(inputs.angles)[:, 1:], measured[1:], 1) / 3
    return replace(inputs, images=(inputs.images - lost).astype(np.float32))


def points_behind(inputs: Inputs) -> Inputs:
    """The cloud with random points in a box of twice its size; they are a third of all points."""
    points = inputs.points()
    low, high = points.min(axis=0), points.max(axis=0)
    count = len(points) // 2
    box = random().uniform(low - (high - low) / 2, high + (high - low) / 2, (count, 3))
    added: Cloud = inputs.cloud[random().integers(len(points), size=count)].copy()
    for axis, name in enumerate("xyz"):
        added[name] = box[:, axis]
    return replace(inputs, cloud=np.concatenate([inputs.cloud, added]))


def half_a_cloud(inputs: Inputs) -> Inputs:
    """The points left of the object's middle."""
    points = inputs.in_camera()
    return replace(inputs, cloud=inputs.cloud[points[:, 0] < np.median(points[:, 0])])


def pose_of_a_neighbor(inputs: Inputs) -> Inputs:
    """The pose of a photo that was taken 8° aside, at the same distance."""
    turn = Rotation.from_euler("y", 8, degrees=True).as_matrix()
    middle = np.median(inputs.in_camera(), axis=0)
    return replace(inputs, rotation=turn @ inputs.rotation, translation=turn @ (inputs.translation - middle) + middle)


def other_focal_length(inputs: Inputs, factor: float) -> Inputs:
    camera = inputs.camera
    params = [camera.fx * factor, camera.fy * factor, camera.cx, camera.cy]
    return replace(inputs, camera=malus.Camera("PINHOLE", camera.width, camera.height, params))


def portrait(inputs: Inputs) -> Inputs:
    """The camera stood upright: the images in the files are turned, and an EXIF entry turns them back."""
    turned: NDArray[np.float32] = np.rot90(inputs.images, 1, (1, 2))
    return replace(inputs, images=turned, mask=np.rot90(inputs.mask), jpeg=95, orientation=6)


def normals_inwards(inputs: Inputs) -> Inputs:
    cloud = inputs.cloud.copy()
    for name in ("nx", "ny", "nz"):
        cloud[name] *= -1
    return dataclasses.replace(inputs, cloud=cloud)


CAPTURE_MISTAKES: dict[str, Callable[[Inputs], Inputs]] = {
    "polarizer set by hand, ± 3°": lambda i: taken_at(i, i.angles + np.deg2rad(random().normal(0, 3, len(i.angles)))),
    "polarizer set by hand, ± 8°": lambda i: taken_at(i, i.angles + np.deg2rad(random().normal(0, 8, len(i.angles)))),
    "turned by 20° instead of 30°": lambda i: taken_at(i, i.angles * 2 / 3),
    "angles in radians": lambda i: replace(i, angles=np.deg2rad(i.angles)),
    "one image moved by 5 px": lambda i: each(i, lambda m, _: warped(m, *places(m, shift=(4, 3))), range(2, 3)),
    "one image moved by 60 px": lambda i: each(i, lambda m, _: warped(m, *places(m, shift=(48, 36))), range(2, 3)),
    "one image overexposed by 2 stops": lambda i: each(i, lambda m, _: m * 4, range(2, 3)),
    "one image underexposed by 3 stops": lambda i: each(i, lambda m, _: m / 8, range(2, 3)),
    "a lamp turned on during the series": second_lamp,
    "auto exposure": auto_exposure,
    "auto white balance": auto_white_balance,
    "JPEG with a picture style": picture_style,
    "circular filter, back to front": circular_filter,
    "filter film": weak_filter,
    "two images the same": lambda i: each(i, lambda m, _: i.images[2], range(3, 4)),
    "two images out of focus": lambda i: each(i, lambda m, _: ndimage.gaussian_filter(m, 3), range(3, 5)),
    "focus changed half way": lambda i: each(i, lambda m, _: warped(m, *places(m, 1.01)), range(3, 6)),
    "cropped": lambda i: replace(i, images=i.images[:, 20:-20, 30:-30], mask=i.mask[20:-20, 30:-30]),
    "cropped by 6 % and resized": lambda i: enlarged(i, 1.06),
    "cropped by 2 % and resized": lambda i: enlarged(i, 1.02),
    "portrait by EXIF": portrait,
    "dark frame missing": lambda i: each(i, lambda m, _: 0.95 * m + 0.05),
    "mask of another size": lambda i: replace(i, mask=i.mask[::2, ::2]),
    "mask of 0 and 1": lambda i: replace(i, mask=(i.mask > 0).astype(np.uint8)),
    "mask too large by 20 px": lambda i: replace(i, mask=ndimage.maximum_filter(i.mask, 41)),
    "points behind and before": points_behind,
    "half a cloud": half_a_cloud,
    "normals inwards": normals_inwards,
    "pose of a photo 8° aside": pose_of_a_neighbor,
    "focal length 3 % too long": lambda i: other_focal_length(i, 1.03),
    "focal length of full frame": lambda i: other_focal_length(i, 1.5),
    "distortion forgotten": distorted,
}
