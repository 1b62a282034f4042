"""Checks of arrays that callers pass to the package."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

#: Intensities above this cannot be shares of the white level, however far an exposure was scaled.
_TOO_BRIGHT = 10


def unmasked(values: ArrayLike, name: str) -> NDArray[Any]:
    """The values as an array; ValueError for a masked array with masked values: values under the mask are no data, but would be read."""
    if np.ma.is_masked(values):
        raise ValueError(
            f"{name} has masked values, expected an array without a mask, such as array.astype(float).filled(numpy.nan)"
        )
    try:
        return np.asarray(values)
    except ValueError:  # lists of different lengths
        raise ValueError(f"{name} has parts of different lengths, expected an array") from None


def as_numbers(values: ArrayLike, name: str) -> NDArray[Any]:
    """The values as an array of whole or real numbers of any shape; ValueError names the argument and its type."""
    array = unmasked(values, name)
    if array.dtype.kind not in "fiu":
        raise ValueError(f"{name} has type {array.dtype}, expected numbers")
    return array


def as_image(values: ArrayLike, name: str, channels: int = 1, dtype: type = np.float32) -> NDArray[Any]:
    """The values as an H×W (or H×W×channels) array of `dtype`, C-contiguous; ValueError names the argument, its shape and the expected shape."""
    array = as_numbers(values, name)
    expected = "(H, W)" if channels == 1 else f"(H, W, {channels})"
    right = array.ndim == 2 if channels == 1 else array.ndim == 3 and array.shape[2] == channels
    if not right or array.size == 0:
        raise ValueError(f"{name} has shape {array.shape}, expected {expected}")
    return np.ascontiguousarray(array, dtype=dtype)


def as_images(
    values: Sequence[ArrayLike] | NDArray[Any], name: str, *, keep_16_bit: bool = False, color: bool = False
) -> list[NDArray[Any]]:
    """K images of one size, float32. keep_16_bit: if all are uint16, they stay uint16. color: H×W×3 is allowed, too."""
    # Of any byte order: big-endian files are often read as they are.
    sixteen = keep_16_bit and all(
        unmasked(value, f"{name}[{k}]").dtype.newbyteorder("=") == np.uint16 for k, value in enumerate(values)
    )
    dtype = np.uint16 if sixteen else np.float32
    images = [
        as_image(value, f"{name}[{k}]", 3 if color and np.ndim(value) == 3 else 1, dtype)
        for k, value in enumerate(values)
    ]
    if not images:
        raise ValueError(f"{name} is empty, expected K arrays (H, W)")
    for k, image in enumerate(images):
        if image.shape != images[0].shape:
            raise ValueError(f"{name}[{k}] has shape {image.shape}, expected {images[0].shape} as {name}[0]")
    return images


def as_intensities(values: Sequence[ArrayLike] | NDArray[Any], name: str) -> list[NDArray[Any]]:
    """K images of one size: uint16 with white at 65535, or float32 in [0, 1] of the white level (only far larger values are refused)."""
    images = as_images(values, name, keep_16_bit=True)
    require_shares(images, name, "uint16")
    return images


def require_shares(images: Sequence[NDArray[Any]], name: str, otherwise: str) -> None:
    """ValueError if float32 images are far too bright for shares of the white level; `otherwise`: what else the message says is expected."""
    for k, image in enumerate(images):
        brightest = np.fmax.reduce(image, axis=None)  # without NaN, which would hide all other values
        if image.dtype == np.float32 and brightest > _TOO_BRIGHT:
            raise ValueError(
                f"{name}[{k}] reaches {brightest:g}, expected linear intensities in [0, 1] of the white level, or {otherwise}"
            )


def as_shares(values: Sequence[ArrayLike] | NDArray[Any], name: str) -> list[NDArray[np.float32]]:
    """As `as_intensities`, but all images are float32 in [0, 1] of the white level."""
    images = as_intensities(values, name)
    return [np.asarray(image if image.dtype == np.float32 else image / 65535, np.float32) for image in images]


def as_angles(values: ArrayLike, name: str, count: int | None = None) -> list[float]:
    """Angles in radians; ValueError for another shape, if a given `count` is not their number, and for values that look like degrees or
    are not finite.
    """
    array = as_numbers(values, name)
    if array.ndim != 1 or (count is not None and len(array) != count):
        expected = "(K,)" if count is None else f"({count},): one angle per image"
        raise ValueError(f"{name} has shape {array.shape}, expected {expected}")
    angles = [float(value) for value in array]
    for k, angle in enumerate(angles):
        if not np.isfinite(angle):
            raise ValueError(f"{name}[{k}] = {angle}, expected a finite number")
        if abs(angle) > 2 * np.pi:
            raise ValueError(f"{name}[{k}] = {angle:g} is beyond 2 pi and so looks like degrees, expected radians")
    return angles


def as_zeniths(values: ArrayLike, name: str) -> NDArray[np.float64]:
    """Zeniths in radians, of any shape, float64; ValueError for values that look like degrees."""
    angles = np.asarray(as_numbers(values, name), dtype=np.float64)
    if (np.abs(angles) > 2 * np.pi).any():
        raise ValueError(f"{name} reaches {np.nanmax(np.abs(angles)):g}, which looks like degrees, expected radians")
    return angles


def as_rows(
    values: ArrayLike, name: str, count: int | None = None, dtype: type[np.generic] = np.float64
) -> NDArray[Any]:
    """The values as an N×3 array of `dtype`, C-contiguous; ValueError for masked values, another shape, or if a given `count` is not N."""
    array = as_numbers(values, name)
    if array.ndim != 2 or array.shape[1] != 3 or (count is not None and len(array) != count):
        raise ValueError(f"{name} has shape {array.shape}, expected ({'N' if count is None else count}, 3)")
    return np.ascontiguousarray(array, dtype=dtype)


def as_colors(values: ArrayLike, name: str, count: int) -> NDArray[np.uint8]:
    """Colors as bytes, `count`×3; ValueError for colors in [0, 1], which would all become black, and for values outside of 0 to 255."""
    colors = as_rows(values, name, count)
    low, high = (colors.min(), colors.max()) if colors.size else (0, 0)
    in_one = np.asarray(values).dtype.kind == "f" and 0 < high <= 1
    if in_one or not (low >= 0 and high <= 255):
        raise ValueError(f"{name} has values from {low:g} to {high:g}, expected 0 to 255")
    return colors.round().astype(np.uint8)


def as_triangles(values: ArrayLike, name: str, vertices: int) -> NDArray[np.uint32]:
    """M×3 indices of `vertices` vertices; ValueError for another shape, for fractions, and for indices of no vertex."""
    array = as_numbers(values, name)
    if array.dtype.kind == "f" and (np.floor(array) != array).any():
        raise ValueError(f"{name} has fractions, expected whole numbers: indices of the vertices")
    indices = as_rows(array, name, dtype=array.dtype.type)
    if indices.size and not (indices.min() >= 0 and indices.max() < vertices):
        raise ValueError(f"{name} has indices from {indices.min()} to {indices.max()}, expected 0 to {vertices - 1}")
    return indices.astype(np.uint32, copy=False)


def require_noise(full_well_e: float, read_noise_e: float, frames_averaged: int) -> None:
    """ValueError for a noise model that no camera has: variances would be infinite or NaN, and every pixel would count as usable."""
    if not (full_well_e > 0 and np.isfinite(full_well_e)):
        raise ValueError(f"full_well_e = {full_well_e}, expected a positive number of electrons")
    if not (read_noise_e >= 0 and np.isfinite(read_noise_e)):
        raise ValueError(f"read_noise_e = {read_noise_e}, expected a number of electrons that is not negative")
    if not frames_averaged >= 1:
        raise ValueError(f"frames_averaged = {frames_averaged}, expected 1 or more")


def as_mask(values: ArrayLike | None, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """H×W, 255 where the values are neither zero nor NaN; without values everywhere."""
    if values is None:
        return np.full(shape, 255, np.uint8)
    array = unmasked(values, "mask")
    if array.dtype.kind not in "fiub":
        raise ValueError(f"mask has type {array.dtype}, expected numbers, or true and false")
    if array.shape != shape:
        raise ValueError(f"mask has shape {array.shape}, expected {shape}")
    return np.where((array != 0) & (array == array), np.uint8(255), np.uint8(0))  # NaN differs from itself


def as_labels(values: ArrayLike, name: str, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """H×W kinds of reflection; ValueError for another shape, and for values other than 0 (decide), 1 (diffuse) and 2 (specular)."""
    array = unmasked(values, name)
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}, expected {shape}")
    others = array[~np.isin(array, (0, 1, 2))]
    if others.size:
        raise ValueError(f"{name} has the value {others[0]}, expected 0 (decide), 1 (diffuse) or 2 (specular)")
    return np.ascontiguousarray(array, np.uint8)


def as_metal(metal: str | complex | Sequence[float]) -> str:
    """The metal as a text of the station file; a refractive index, n + k i or (n, k), becomes "n+ki"."""
    if isinstance(metal, str):
        return metal
    if isinstance(metal, complex):
        metal = (metal.real, metal.imag)
    index = as_numbers(metal, "metal")
    if index.shape != (2,):
        raise ValueError(
            f"metal has shape {index.shape}, expected a word or the two numbers n and k of a refractive index"
        )
    n, k = index.tolist()
    return f"{n}+{k}i"


def as_reflection(values: str | ArrayLike, shape: tuple[int, ...]) -> tuple[str, NDArray[np.uint8] | None]:
    """The kind of reflection of all pixels by its name, or "labels" and the label of each pixel (see `as_labels`)."""
    return (values, None) if isinstance(values, str) else ("labels", as_labels(values, "reflection", shape))
