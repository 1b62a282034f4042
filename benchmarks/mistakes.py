"""Mistakes of a person in a station's files, made on a copy. `wrong_inputs.py` runs the program on each of them."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from PIL import Image
from rendered_files import Array, Cloud, read_cloud, toml_text, vectors, with_vectors, write_cloud
from scipy.spatial.transform import Rotation

import malus

DISPLAY_GAMMA = 2.2
POINT, NORMAL = ("x", "y", "z"), ("nx", "ny", "nz")


@dataclass(frozen=True)
class Inputs:
    """images: K×H×W or K×H×W×3, linear; x_in_cam = rotation x + translation; mask: 255 = object, or a photograph.

    stated: other keys of [polarized] in the station file; optics: its table [optics]. jpeg: the images become 8-bit sRGB
    files of this quality, with the EXIF orientation `orientation`.
    """

    name: str
    images: Array
    angles: Array
    mask: Array
    camera: malus.Camera
    cloud: Cloud
    rotation: Array
    translation: Array
    unit: str
    stated: dict[str, Any]
    optics: dict[str, Any]
    jpeg: int | None = None
    orientation: int = 1

    def points(self) -> Array:
        return vectors(self.cloud, POINT)

    def in_camera(self) -> Array:
        return self.points() @ self.rotation.T + self.translation

    def with_points(self, points: Array) -> Inputs:
        return replace(self, cloud=with_vectors(self.cloud, POINT, points))

    def with_points_in_camera(self, points: Array, turn: Array | None = None) -> Inputs:
        moved = self.with_points((points - self.translation) @ self.rotation)
        if turn is None:
            return moved
        normals = vectors(self.cloud, NORMAL) @ self.rotation.T @ turn.T @ self.rotation
        return replace(moved, cloud=with_vectors(moved.cloud, NORMAL, normals))

    def is_comparable(self, other: Inputs) -> bool:
        """Whether `other` is another object whose images could be confused with these, having the same shape."""
        return other.name != self.name and other.images.shape == self.images.shape


def read(path: Path) -> Inputs:
    about = malus.Station.load(path).describe()
    tables = tomllib.loads(path.read_text())
    polarized = tables["polarized"]
    images = np.stack([np.asarray(Image.open(name), dtype=np.float32) for name in about["images"]])
    if images.ndim == 4:
        images = images.mean(axis=3)
    images /= polarized.get("white_level", 255 if images.max() < 256 else 65535)
    if polarized.get("response") == "srgb":
        images = np.where(images < 0.04045, images / 12.92, ((images + 0.055) / 1.055) ** 2.4)
    mask = np.full(images.shape[1:], 255, np.uint8)
    if "mask" in polarized:
        mask = np.where(np.asarray(Image.open(path.parent / polarized["mask"])) > 0, 255, 0).astype(np.uint8)
    camera = about["camera"]
    params = camera["params"]
    focal = params[:2] if len(params) > 3 else [params[0]] * 2
    return Inputs(
        about["name"], images.astype(np.float32), np.deg2rad(polarized["angles_deg"]), mask,
        malus.Camera("PINHOLE", camera["width"], camera["height"], [*focal, *params[-2:]]), read_cloud(Path(about["prior_cloud"])),
        np.array(camera["rotation"]), np.array(camera["translation"]), about["unit"],
        {key: polarized[key] for key in ("frames_averaged", "full_well_e", "read_noise_e") if key in polarized}, tables.get("optics", {}),
    )  # fmt: skip


def moved(inputs: Inputs, length: float) -> Inputs:
    """The cloud moved to the right of the image."""
    return inputs.with_points_in_camera(inputs.in_camera() + [length, 0, 0])


def moved_by_share(inputs: Inputs) -> Inputs:
    """The cloud moved by 5 % of the object's width."""
    columns = np.nonzero(inputs.mask.any(axis=0))[0]
    return moved(inputs, 0.05 * np.ptp(columns) / inputs.camera.fx * np.median(inputs.in_camera()[:, 2]))


def turned(inputs: Inputs, degrees: float) -> Inputs:
    angle = np.deg2rad(degrees)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    points = inputs.in_camera()
    middle = np.median(points, axis=0)
    return inputs.with_points_in_camera((points - middle) @ turn.T + middle, turn)


def larger(inputs: Inputs) -> Inputs:
    points = inputs.in_camera()
    middle = np.median(points, axis=0)
    return inputs.with_points_in_camera(middle + 1.05 * (points - middle))


def axes_changed(inputs: Inputs, matrix: list[list[int]]) -> Inputs:
    """Points and normals in the world's axes times a matrix of 0 and ±1."""
    turn = np.array(matrix)
    cloud = with_vectors(inputs.cloud, NORMAL, vectors(inputs.cloud, NORMAL) @ turn.T)
    return replace(inputs, cloud=cloud).with_points(inputs.points() @ turn.T)


def exchanged(angles: Array) -> Array:
    order = np.arange(len(angles))
    order[[1, 3]] = order[[3, 1]]
    return np.asarray(angles[order])


def encoded(inputs: Inputs) -> Inputs:
    return replace(inputs, images=np.maximum(inputs.images, 0) ** np.float32(1 / DISPLAY_GAMMA))


MISTAKES: dict[str, Callable[[Inputs], Inputs]] = {
    "as it is": lambda i: i,
    "angles clockwise": lambda i: replace(i, angles=-i.angles),
    "zero off by 20°": lambda i: replace(i, angles=i.angles + np.deg2rad(20)),
    "zero off by 90°": lambda i: replace(i, angles=i.angles + np.deg2rad(90)),
    "two angles exchanged": lambda i: replace(i, angles=exchanged(i.angles)),
    "angles are numbers of frames": lambda i: replace(i, angles=np.deg2rad(123.0 + np.arange(len(i.angles)))),
    "encoded, taken as linear": encoded,
    "linear, taken as encoded": lambda i: replace(i, stated=i.stated | dict(response="srgb")),
    "images turned by 180°": lambda i: replace(i, images=i.images[:, ::-1, ::-1], mask=i.mask[::-1, ::-1]),
    "images mirrored": lambda i: replace(i, images=i.images[:, :, ::-1], mask=i.mask[:, ::-1]),
    "mask inverted": lambda i: replace(i, mask=255 - i.mask),
    "mask black": lambda i: replace(i, mask=np.zeros_like(i.mask)),
    "mask is a photograph": lambda i: replace(i, mask=np.rint(255 * np.clip(i.images[0], 0, 1)).astype(np.uint8)),
    "cloud 5 mm aside": lambda i: moved(i, 5),
    "cloud 5 % aside": moved_by_share,
    "cloud turned by 1°": lambda i: turned(i, 1),
    "cloud turned by 2°": lambda i: turned(i, 2),
    "cloud 5 % too large": larger,
    "cloud in meters": lambda i: i.with_points(i.points() / 1000),
    "cloud's x negated": lambda i: axes_changed(i, [[-1, 0, 0], [0, 1, 0], [0, 0, 1]]),
    "cloud's z negated": lambda i: axes_changed(i, [[1, 0, 0], [0, 1, 0], [0, 0, -1]]),
    "cloud's y and z exchanged": lambda i: axes_changed(i, [[1, 0, 0], [0, 0, 1], [0, 1, 0]]),
    "pose the other way": lambda i: replace(i, rotation=i.rotation.T, translation=-i.rotation.T @ i.translation),
    "unit meters for millimeters": lambda i: replace(i, unit="m"),
    "meters, unit forgotten": lambda i: replace(i.with_points(i.points() / 1000), translation=i.translation / 1000),
}
OTHER_OBJECT = "images of another object"


def write_images(inputs: Inputs, folder: Path) -> list[str]:
    names = []
    for number, image in enumerate(np.clip(inputs.images, 0, 1)):
        if inputs.jpeg is None:
            names.append(f"{number}.tif")
            tifffile.imwrite(folder / names[-1], np.rint(image * 65535).astype(np.uint16))
        else:
            names.append(f"{number}.jpg")
            shown = np.where(image < 0.0031308, 12.92 * image, 1.055 * image ** (1 / 2.4) - 0.055)
            exif = Image.Exif()
            exif[0x0112] = inputs.orientation
            Image.fromarray(np.rint(shown * 255).astype(np.uint8)).save(
                folder / names[-1], quality=inputs.jpeg, exif=exif
            )
    return names


def write(inputs: Inputs, folder: Path) -> Path:
    """Write these inputs and a station file for them, like a person's; returns the station file."""
    folder.mkdir(parents=True)
    names = write_images(inputs, folder)
    tifffile.imwrite(folder / "mask.tif", inputs.mask)
    write_cloud(folder / "cloud.ply", inputs.cloud)
    x, y, z, w = Rotation.from_matrix(inputs.rotation).as_quat().tolist()
    camera = inputs.camera
    response = "linear" if inputs.jpeg is None else "srgb"
    tables: dict[str, dict[str, Any]] = dict(
        station=dict(name="wrong", unit=inputs.unit),
        polarized=dict(images=names, angles_deg=np.rad2deg(inputs.angles).tolist(), mask="mask.tif", response=response) | inputs.stated,
        optics=inputs.optics,
        camera=dict(
            model="PINHOLE", width=camera.width, height=camera.height,
            params=[camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5],
            qvec=[w, x, y, z], tvec=inputs.translation.tolist(),
        ),
        prior=dict(cloud="cloud.ply"),
    )  # fmt: skip
    (folder / "station.toml").write_text(toml_text(tables))
    return folder / "station.toml"
