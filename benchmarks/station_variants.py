"""Variants of a rendered station for `harm.py`: correct, with a wrong coarse surface, or with a wrong setting.

A variant is drawn (`draw`) and then written to a folder of its own (`write`): a station file that names the images of the rendered
station, and a cloud. If a sensor is drawn as well (`draw_sensor`), new images are written, with more noise and moved; this needs only the
low-noise images. The rendered station is only read.
"""

from __future__ import annotations

import json
import tomllib
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image
from rendered_files import Array, Cloud, read_cloud, toml_text, vectors, with_vectors, write_cloud
from scipy import ndimage

POINT, NORMAL = ("x", "y", "z"), ("nx", "ny", "nz")

#: Errors of the coarse surface: distorted or incomplete, as from stereo without control or with little texture.
PRIOR_ERRORS = ("bias", "tilt", "scale", "holes")
#: Wrong settings of a user: of the images, and of the cloud.
IMAGE_SETTINGS = ("direction", "zero", "response", "order")
CLOUD_SETTINGS = ("unit", "shifted", "turned", "mirrored")
#: Variants whose coarse surface is off the truth everywhere. For these, a comparison of the result with the prior means little, since
#: only the prior determines where the object is.
WRONG_PRIOR = ("bias", "tilt", "scale", *CLOUD_SETTINGS)


#: Name of a correct station whose coarse surface is made from its photographs.
FROM_PHOTOS = "from photos"


@dataclass(frozen=True)
class Variant:
    """The differences from the rendered station."""

    kind: str  # "correct", "prior" or "setting"
    name: str  # what is wrong; "correct", FROM_PHOTOS
    noisy: bool = False  # single frames, each moved, instead of the registered means of 16
    good_cloud: bool = False  # the cloud as if stereo had worked everywhere, if the scene has it
    amount: dict[str, Any] = field(default_factory=dict)
    sensor: dict[str, float] = field(
        default_factory=dict
    )  # of newly written images; empty = the rendered images are used


def signed(random: np.random.Generator, low: float, high: float) -> float:
    return float(random.uniform(low, high) * random.choice([-1, 1]))


def draw_amount(name: str, random: np.random.Generator) -> dict[str, Any]:
    """Draw the amount of an error."""
    match name:
        case "bias":
            return dict(gsd=signed(random, 3, 30))
        case "tilt":
            return dict(deg=float(random.uniform(0.5, 4)), axis_deg=float(random.uniform(0, 360)))
        case "scale":
            return dict(factor=1 + signed(random, 0.01, 0.05))
        case "holes":
            return dict(share=float(random.uniform(0.3, 0.7)), seed=int(random.integers(2**31)))
        case "direction":
            return dict(angle_direction="cw")
        case "zero":
            return dict(angle_zero_deg=signed(random, 10, 90))
        case "response":
            return dict(response=str(random.choice(["srgb", "gamma:2.2", "gamma:0.45"])))
        case "order":
            order = np.arange(6)
            while (order == np.arange(6)).all():
                order = random.permutation(6)
            return dict(order=order.tolist())
        case "unit":
            return dict(factor=float(random.choice([0.001, 0.1, 1 / 25.4])))
        case "shifted":
            return dict(share=float(random.uniform(0.03, 0.2)), axis_deg=float(random.uniform(0, 360)))
        case "turned":
            return dict(deg=signed(random, 5, 180))
        case "mirrored":
            return {}
    raise ValueError(f"no variant {name}")


def draw(random: np.random.Generator) -> Variant:
    """Draw a variant: half of them are correct, a quarter have a wrong prior, a quarter a wrong setting."""
    kind = str(random.choice(["correct", "prior", "setting"], p=[0.5, 0.25, 0.25]))
    noisy, good_cloud = (bool(random.random() < 0.5) for _ in range(2))
    if kind == "correct":
        return Variant(kind, "correct", noisy, good_cloud)
    name = str(random.choice(PRIOR_ERRORS if kind == "prior" else IMAGE_SETTINGS + CLOUD_SETTINGS))
    return Variant(kind, name, noisy, good_cloud, draw_amount(name, random))


def draw_sensor(random: np.random.Generator) -> dict[str, float]:
    """Draw a sensor that is noisier than the rendered one: factors on the rendered full well and read noise, and a seed for the noise."""
    return dict(
        full_well=float(np.exp(random.uniform(np.log(0.3), 0))),
        read_noise=float(np.exp(random.uniform(0, np.log(2.5)))),
        seed=int(random.integers(2**31)),
    )


# --- the cloud


def turn(axis: Array, angle_rad: float) -> Array:
    """Matrix of a turn about a unit axis (Rodrigues)."""
    cross = np.cross(np.eye(3), axis)
    matrix = np.eye(3) - np.sin(angle_rad) * cross + (1 - np.cos(angle_rad)) * cross @ cross
    return np.asarray(matrix)


def rest_with_holes(points: Array, focal_px: float, amount: dict[str, Any]) -> NDArray[np.bool_]:
    """Mask of the points (camera frame) that remain after round holes in the image have removed a share of them."""
    random = np.random.default_rng(amount["seed"])
    pixels = points[:, :2] / points[:, 2:] * focal_px
    radii = 0.1 * np.ptp(pixels, axis=0).min() * np.array([0.5, 1.5])
    rest = np.ones(len(points), bool)
    while rest.mean() > 1 - amount["share"]:
        center = pixels[random.choice(np.flatnonzero(rest))]
        rest &= np.linalg.norm(pixels - center, axis=1) > random.uniform(*radii)
    return rest


def change_points(points: Array, variant: Variant, gsd: float, extent: float) -> tuple[Array, Array]:
    """The points (camera frame) changed by the variant, and the matrix for their normals."""
    amount, center, same = variant.amount, np.median(points, axis=0), np.eye(3)
    angle = np.radians(amount.get("axis_deg", 0.0))
    across = np.array([np.cos(angle), np.sin(angle), 0.0])
    view = np.array([0.0, 0.0, 1.0])
    match variant.name:
        case "bias":
            return points + view * amount["gsd"] * gsd, same
        case "shifted":
            return points + across * amount["share"] * extent, same
        case "scale":
            return center + (points - center) * amount["factor"], same
        case "tilt" | "turned":
            matrix = turn(across if variant.name == "tilt" else view, np.radians(amount["deg"]))
            return center + (points - center) @ matrix.T, matrix
        case "mirrored":
            matrix = np.diag([-1.0, 1.0, 1.0])
            return center + (points - center) @ matrix, matrix
    return points, same


def change_cloud(cloud: Cloud, variant: Variant, camera: dict[str, Any], gsd: float) -> Cloud:
    """The cloud changed by the variant. camera: the station's entry in meta.json."""
    rotation, shift = np.array(camera["R_world_to_cam"]), np.array(camera["t_world_to_cam"])
    world = vectors(cloud, POINT)
    points = world @ rotation.T + shift
    if variant.name == "holes":
        return np.asarray(cloud[rest_with_holes(points, camera["K"][0][0], variant.amount)])
    if variant.name == "unit":  # the whole file is in another unit than the camera
        world, normal_matrix = world * variant.amount["factor"], np.eye(3)
    else:
        points, normal_matrix = change_points(points, variant, gsd, gsd * camera["width"])
        world = (points - shift) @ rotation
    normals = vectors(cloud, NORMAL) @ rotation.T @ normal_matrix.T @ rotation
    return with_vectors(with_vectors(cloud, POINT, world), NORMAL, normals)


# --- the images


def moved(image: Array, random: np.random.Generator) -> Array:
    """The image with the motion due to a filter turned by hand: shifted by up to 1.5 px, turned by up to 0.03°."""
    angle = np.radians(random.uniform(-0.03, 0.03))
    matrix = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    middle = (np.array(image.shape) - 1) / 2
    offset = middle + random.uniform(-1.05, 1.05, 2) - matrix @ middle
    return np.asarray(ndimage.affine_transform(image, matrix, offset, order=3, mode="mirror"))


def write_images(station: Path, variant: Variant, folder: Path, polarized: dict[str, Any]) -> None:
    """Write the station's low-noise images with the noise of the variant's sensor, and update the table `polarized`."""
    random = np.random.default_rng(int(variant.sensor["seed"]))
    rendered = [polarized[key] for key in ("full_well_e", "read_noise_e", "frames_averaged")]
    full_well, read_noise = rendered[0] * variant.sensor["full_well"], rendered[1] * variant.sensor["read_noise"]
    white, frames = polarized["white_level"], 1 if variant.noisy else rendered[2]
    names = []
    for number, name in enumerate(polarized["images"]):
        image = np.asarray(Image.open(station / name), dtype=float) / white
        if variant.noisy and number > 0:
            image = moved(image, random)
        light = np.maximum(image, 0)
        variances = [
            (light * well + read**2) / well**2 / n for well, read, n in ((full_well, read_noise, frames), rendered)
        ]
        image += random.standard_normal(image.shape) * np.sqrt(np.maximum(variances[0] - variances[1], 0))
        names.append(f"{number}.tif")
        tifffile.imwrite(folder / names[-1], np.rint(np.clip(image, 0, 1) * white).astype(np.uint16))
    polarized.update(images=names, full_well_e=full_well, read_noise_e=read_noise, frames_averaged=frames)


# --- the station file


def change_settings(tables: dict[str, dict[str, Any]], variant: Variant) -> None:
    """Put the variant's wrong setting into the tables of a station file."""
    polarized = tables["polarized"]
    if variant.name == "order":
        polarized["images"] = [polarized["images"][k] for k in variant.amount["order"]]
    elif variant.name in IMAGE_SETTINGS:
        polarized.update(variant.amount)


def write(station: Path, variant: Variant, folder: Path) -> Path:
    """Write the variant of a rendered station into a folder; returns its station file."""
    meta = json.loads((station / "meta.json").read_text())
    noisy_file = variant.noisy and not variant.sensor
    tables = tomllib.loads((station / ("station_noisy.toml" if noisy_file else "station.toml")).read_text())
    tables.pop("patch", None)
    folder.mkdir(parents=True, exist_ok=True)
    if variant.sensor:
        write_images(station, variant, folder, tables["polarized"])
    else:
        tables["polarized"]["images"] = [str((station / name).resolve()) for name in tables["polarized"]["images"]]
    change_settings(tables, variant)
    for table, key in (("polarized", "mask"), ("camera", "colmap_model")):
        if key in tables[table]:
            tables[table][key] = str((station / tables[table][key]).resolve())
    cloud = station / tables["prior"]["cloud"]
    good = cloud.with_name("mvs_cloud_good.ply")
    if variant.good_cloud and good.exists():
        cloud = good
    tables["prior"]["cloud"] = "cloud.ply"
    write_cloud(folder / "cloud.ply", change_cloud(read_cloud(cloud), variant, meta["station"], meta["gsd_mm"]))
    path = folder / "station.toml"
    path.write_text(toml_text(tables))
    (folder / "variant.json").write_text(json.dumps(asdict(variant), indent=1) + "\n")
    return path
