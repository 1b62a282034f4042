"""Checks at the door: arrays in, arrays out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


def as_image(values: ArrayLike, name: str, channels: int = 1, dtype: type = np.float32) -> NDArray[Any]:
    """H×W (or H×W×channels) dtype, C-contiguous; ValueError names the argument, its shape and the expected one."""
    array = np.asarray(values)
    if array.dtype.kind not in "fiu":
        raise ValueError(f"{name} has type {array.dtype}, expected numbers")
    expected = "(H, W)" if channels == 1 else f"(H, W, {channels})"
    right = array.ndim == 2 if channels == 1 else array.ndim == 3 and array.shape[2] == channels
    if not right or array.size == 0:
        raise ValueError(f"{name} has shape {array.shape}, expected {expected}")
    return np.ascontiguousarray(array, dtype=dtype)


def as_images(
    values: Sequence[ArrayLike] | NDArray[Any], name: str, *, keep_16_bit: bool = False
) -> list[NDArray[Any]]:
    """K images of one size, float32; keep_16_bit: uint16 ones stay so if all of them are."""
    sixteen = keep_16_bit and all(np.asarray(value).dtype == np.uint16 for value in values)
    dtype = np.uint16 if sixteen else np.float32
    images = [as_image(value, f"{name}[{k}]", dtype=dtype) for k, value in enumerate(values)]
    if not images:
        raise ValueError(f"{name} is empty, expected K arrays (H, W)")
    for k, image in enumerate(images):
        if image.shape != images[0].shape:
            raise ValueError(f"{name}[{k}] has shape {image.shape}, expected {images[0].shape} as {name}[0]")
    return images


def as_mask(values: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """H×W, 255 where the values are non-zero."""
    array = np.asarray(values)
    if array.shape != shape:
        raise ValueError(f"mask has shape {array.shape}, expected {shape}")
    return np.where(array != 0, np.uint8(255), np.uint8(0))
