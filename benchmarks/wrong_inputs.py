"""What is said of wrong inputs: each mistake is made on a copy of a station's files, and the program runs up to its checks.

    python benchmarks/wrong_inputs.py STATION.toml…

STATION.toml: with 16- or 8-bit images at stated angles, an undistorted camera and a PLY cloud. Prints one line a mistake, how the run ends:
an exit code, low confidence, or it goes on; and the words of every warning and error; and after the last station, of each mistake,
how often each end. The station as it is comes first: whatever is said of it is a false alarm, unless its truth is known to be otherwise.
"""

from __future__ import annotations

import argparse
import collections
import json
import tempfile
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tifffile
import trimesh
from PIL import Image

import malus

DISPLAY_GAMMA = 2.2


@dataclass(frozen=True)
class Inputs:
    """images: K×H×W linear; points, normals, colors: N×3; x_in_cam = rotation x + translation."""

    images: np.ndarray
    angles: np.ndarray
    mask: np.ndarray
    camera: malus.Camera
    points: np.ndarray
    normals: np.ndarray
    colors: np.ndarray
    rotation: np.ndarray
    translation: np.ndarray
    frames: int
    unit: str

    def in_camera(self) -> np.ndarray:
        return self.points @ self.rotation.T + self.translation

    def with_points_in_camera(self, points: np.ndarray, turn: np.ndarray | None = None) -> Inputs:
        normals = self.normals if turn is None else self.normals @ self.rotation.T @ turn.T @ self.rotation
        return replace(self, points=(points - self.translation) @ self.rotation, normals=normals)


def read(path: Path) -> Inputs:
    about = malus.Station.load(path).describe()
    polarized = tomllib.loads(path.read_text())["polarized"]
    images = np.stack([np.asarray(Image.open(name), dtype=np.float32) for name in about["images"]])
    if images.ndim == 4:
        images = images.mean(axis=3)
    images /= polarized.get("white_level", 255 if images.max() < 256 else 65535)
    if polarized.get("response") == "srgb":
        images = np.where(images < 0.04045, images / 12.92, ((images + 0.055) / 1.055) ** 2.4)
    mask = np.ones(images.shape[1:], bool)
    if "mask" in polarized:
        mask = np.asarray(Image.open(path.parent / polarized["mask"])) > 0
    cloud = trimesh.load(about["prior_cloud"])
    vertex = cloud.metadata["_ply_raw"]["vertex"]["data"]
    camera = about["camera"]
    params = camera["params"]
    focal = params[:2] if len(params) > 3 else [params[0]] * 2
    return Inputs(
        images.astype(np.float32), np.deg2rad(polarized["angles_deg"]), mask,
        malus.Camera("PINHOLE", camera["width"], camera["height"], [*focal, *params[-2:]]),
        np.asarray(cloud.vertices, float), np.stack([vertex[n] for n in ("nx", "ny", "nz")], -1),
        np.asarray(cloud.colors)[:, :3], np.array(camera["rotation"]), np.array(camera["translation"]),
        polarized.get("frames_averaged", 1), about["unit"],
    )  # fmt: skip


def shifted(inputs: Inputs) -> Inputs:
    points = inputs.in_camera()
    columns = np.nonzero(inputs.mask.any(axis=0))[0]
    share = 0.05 * np.ptp(columns) / inputs.camera.fx
    return inputs.with_points_in_camera(points + [share * np.median(points[:, 2]), 0, 0])


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


def exchanged(angles: np.ndarray) -> np.ndarray:
    order = np.arange(len(angles))
    order[[1, 3]] = order[[3, 1]]
    return angles[order]


MISTAKES: dict[str, Callable[[Inputs], Inputs]] = {
    "as it is": lambda i: i,
    "angles clockwise": lambda i: replace(i, angles=-i.angles),
    "zero off by 20°": lambda i: replace(i, angles=i.angles + np.deg2rad(20)),
    "two angles exchanged": lambda i: replace(i, angles=exchanged(i.angles)),
    "encoded, taken as linear": lambda i: replace(i, images=np.maximum(i.images, 0) ** np.float32(1 / DISPLAY_GAMMA)),
    "linear, taken as encoded": lambda i: replace(i, images=np.maximum(i.images, 0) ** np.float32(DISPLAY_GAMMA)),
    "images turned by 180°": lambda i: replace(i, images=i.images[:, ::-1, ::-1], mask=i.mask[::-1, ::-1]),
    "images mirrored": lambda i: replace(i, images=i.images[:, :, ::-1], mask=i.mask[:, ::-1]),
    "mask inverted": lambda i: replace(i, mask=~i.mask),
    "cloud 5 % aside": shifted,
    "cloud turned by 2°": lambda i: turned(i, 2),
    "cloud 5 % too large": larger,
    "cloud in metres": lambda i: replace(i, points=i.points / 1000),
    "cloud's z negated": lambda i: replace(i, points=i.points * [1, 1, -1], normals=i.normals * [1, 1, -1]),
    "pose the other way": lambda i: replace(
        i, rotation=i.rotation.T, translation=-i.rotation.T @ i.translation
    ),
    "unit metres for millimetres": lambda i: replace(i, unit="m"),
}  # fmt: skip


def write(inputs: Inputs, folder: Path) -> Path:
    """A station file of these inputs, as a person would have it."""
    folder.mkdir(parents=True)
    names = []
    for number, image in enumerate(inputs.images):
        names.append(f"{number}.tif")
        tifffile.imwrite(folder / names[-1], np.rint(np.clip(image, 0, 1) * 65535).astype(np.uint16))
    tifffile.imwrite(folder / "mask.tif", np.where(inputs.mask, 255, 0).astype(np.uint8))
    cloud = np.zeros(len(inputs.points), [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")]
                     + [(name, "u1") for name in ("red", "green", "blue")])  # fmt: skip
    for values, fields in ((inputs.points, "xyz"), (inputs.normals, ("nx", "ny", "nz")),
                           (inputs.colors, ("red", "green", "blue"))):  # fmt: skip
        for column, field in enumerate(fields):
            cloud[field] = values[:, column]
    kinds = {"<f4": "float", "|u1": "uchar"}
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(cloud)}"]
    header += [f"property {kinds[cloud.dtype[name].str]} {name}" for name in cloud.dtype.names or ()]
    (folder / "cloud.ply").write_bytes("\n".join([*header, "end_header", ""]).encode() + cloud.tobytes())
    matrix = np.eye(4)
    matrix[:3, :3] = inputs.rotation
    w, x, y, z = trimesh.transformations.quaternion_from_matrix(matrix)
    camera = inputs.camera
    (folder / "station.toml").write_text(f"""
[station]
name = "wrong"
unit = "{inputs.unit}"
[polarized]
images = {json.dumps(names)}
angles_deg = {np.rad2deg(inputs.angles).tolist()}
mask = "mask.tif"
frames_averaged = {inputs.frames}
[camera]
model = "PINHOLE"
width = {camera.width}
height = {camera.height}
params = [{camera.fx}, {camera.fy}, {camera.cx + 0.5}, {camera.cy + 0.5}]
qvec = [{w}, {x}, {y}, {z}]
tvec = {inputs.translation.tolist()}
[prior]
cloud = "cloud.ply"
""")
    return folder / "station.toml"


@dataclass(frozen=True)
class Said:
    """How a run ended (exit code, 0 = done), whether its confidence is low for what the checks found, and its words."""

    code: int
    is_low: bool
    words: list[str]


def run(inputs: Inputs) -> Said:
    with tempfile.TemporaryDirectory() as folder:
        warnings: list[str] = []
        work = Path(folder) / "work"
        try:
            malus.reconstruct(
                malus.Station.load(write(inputs, Path(folder) / "station")), until="evidence", workspace=work,
                threads=2, log=lambda level, text: warnings.append(text) if level == "warning" else None,
            )  # fmt: skip
        except malus.MalusError as error:
            return Said(error.exit_code, False, [str(error)])
        found = json.loads((work / "evidence/findings.json").read_text())
        return Said(0, any(finding["severity"] in ("warning", "error") for finding in found), warnings)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("stations", nargs="+", type=Path)
    stations = parser.parse_args().stations
    counts: dict[str, collections.Counter[str]] = collections.defaultdict(collections.Counter)
    for path in stations:
        inputs = read(path)
        print(path)
        for name, mistake in MISTAKES.items():
            if name == "mask inverted" and inputs.mask.all():
                continue
            said = run(mistake(inputs))
            end = f"exit code {said.code}" if said.code else "low confidence" if said.is_low else "goes on"
            counts[name][end] += 1
            print(f"  {name}: {end}", flush=True)
            for words in said.words:
                print(f"    {words}", flush=True)
    print(f"{len(stations)} stations")
    for name, ends in counts.items():
        print(f"  {name}: " + ", ".join(f"{end} {count}" for end, count in ends.items()))


if __name__ == "__main__":
    main()
