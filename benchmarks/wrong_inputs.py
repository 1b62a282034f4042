"""What is said of wrong inputs: each mistake is made on a copy of a station's files, and the program runs on it.

    python benchmarks/wrong_inputs.py STATION.toml… [--until assess] [--only MISTAKE…]

STATION.toml: with 16- or 8-bit images at stated angles, an undistorted camera and a binary PLY cloud. Prints one line a mistake, how the
run ends: an exit code, or status and confidence; and the words of every warning and error; and after the last station, of each mistake,
how often each end, and how often nothing was said. The station as it is comes first: whatever is said of it is a false alarm, unless its
truth is known to be otherwise. "images of another object" are those of the next station of another name whose images have the same size.
With `--until evidence` nothing is fused, and the confidence is what the checks make of it.
"""

from __future__ import annotations

import argparse
import collections
import json
import tempfile
import tomllib
from collections.abc import Callable, Sequence
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
    """images: K×H×W linear; x_in_cam = rotation x + translation; mask: H×W, 255 = object, or a photograph."""

    name: str
    images: Array
    angles: Array
    mask: Array
    camera: malus.Camera
    cloud: Cloud
    rotation: Array
    translation: Array
    frames: int
    unit: str

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
        """Another object, seen by images that could be confused with these."""
        return other.name != self.name and other.images.shape == self.images.shape


def read(path: Path) -> Inputs:
    about = malus.Station.load(path).describe()
    polarized = tomllib.loads(path.read_text())["polarized"]
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
        np.array(camera["rotation"]), np.array(camera["translation"]), polarized.get("frames_averaged", 1), about["unit"],
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


def z_negated(inputs: Inputs) -> Inputs:
    away = np.array([1, 1, -1])
    cloud = with_vectors(inputs.cloud, NORMAL, vectors(inputs.cloud, NORMAL) * away)
    return replace(inputs, cloud=cloud).with_points(inputs.points() * away)


def exchanged(angles: Array) -> Array:
    order = np.arange(len(angles))
    order[[1, 3]] = order[[3, 1]]
    return np.asarray(angles[order])


def power(inputs: Inputs, exponent: float) -> Inputs:
    return replace(inputs, images=np.maximum(inputs.images, 0) ** np.float32(exponent))


MISTAKES: dict[str, Callable[[Inputs], Inputs]] = {
    "as it is": lambda i: i,
    "angles clockwise": lambda i: replace(i, angles=-i.angles),
    "zero off by 20°": lambda i: replace(i, angles=i.angles + np.deg2rad(20)),
    "zero off by 90°": lambda i: replace(i, angles=i.angles + np.deg2rad(90)),
    "two angles exchanged": lambda i: replace(i, angles=exchanged(i.angles)),
    "angles are numbers of frames": lambda i: replace(i, angles=np.deg2rad(123.0 + np.arange(len(i.angles)))),
    "encoded, taken as linear": lambda i: power(i, 1 / DISPLAY_GAMMA),
    "linear, taken as encoded": lambda i: power(i, DISPLAY_GAMMA),
    "images turned by 180°": lambda i: replace(i, images=i.images[:, ::-1, ::-1], mask=i.mask[::-1, ::-1]),
    "images mirrored": lambda i: replace(i, images=i.images[:, :, ::-1], mask=i.mask[:, ::-1]),
    "mask inverted": lambda i: replace(i, mask=255 - i.mask),
    "mask black": lambda i: replace(i, mask=np.zeros_like(i.mask)),
    "mask is a photograph": lambda i: replace(i, mask=np.rint(255 * np.clip(i.images[0], 0, 1)).astype(np.uint8)),
    "cloud 5 % aside": shifted,
    "cloud turned by 2°": lambda i: turned(i, 2),
    "cloud 5 % too large": larger,
    "cloud in metres": lambda i: i.with_points(i.points() / 1000),
    "cloud's z negated": z_negated,
    "pose the other way": lambda i: replace(i, rotation=i.rotation.T, translation=-i.rotation.T @ i.translation),
    "unit metres for millimetres": lambda i: replace(i, unit="m"),
    "metres, unit forgotten": lambda i: replace(i.with_points(i.points() / 1000), translation=i.translation / 1000),
}
OTHER_OBJECT = "images of another object"


def write(inputs: Inputs, folder: Path) -> Path:
    """A station file of these inputs, as a person would have it."""
    folder.mkdir(parents=True)
    names = []
    for number, image in enumerate(inputs.images):
        names.append(f"{number}.tif")
        tifffile.imwrite(folder / names[-1], np.rint(np.clip(image, 0, 1) * 65535).astype(np.uint16))
    tifffile.imwrite(folder / "mask.tif", inputs.mask)
    write_cloud(folder / "cloud.ply", inputs.cloud)
    x, y, z, w = Rotation.from_matrix(inputs.rotation).as_quat().tolist()
    camera = inputs.camera
    tables: dict[str, dict[str, Any]] = dict(
        station=dict(name="wrong", unit=inputs.unit),
        polarized=dict(images=names, angles_deg=np.rad2deg(inputs.angles).tolist(), mask="mask.tif", frames_averaged=inputs.frames),
        camera=dict(
            model="PINHOLE", width=camera.width, height=camera.height,
            params=[camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5],
            qvec=[w, x, y, z], tvec=inputs.translation.tolist(),
        ),
        prior=dict(cloud="cloud.ply"),
    )  # fmt: skip
    (folder / "station.toml").write_text(toml_text(tables))
    return folder / "station.toml"


@dataclass(frozen=True)
class Said:
    """How a run ended, as one line, and its words."""

    end: str
    words: list[str]


def run(inputs: Inputs, until: str) -> Said:
    with tempfile.TemporaryDirectory() as folder:
        warnings: list[str] = []
        work = Path(folder) / "work"
        try:
            malus.reconstruct(
                malus.Station.load(write(inputs, Path(folder) / "station")), until=until, workspace=work,
                threads=2, log=lambda level, text: warnings.append(text) if level == "warning" else None,
            )  # fmt: skip
        except malus.MalusError as error:
            return Said(f"exit code {error.exit_code}", [str(error)])
        if until == "assess":
            quality = json.loads((work / "quality.json").read_text())
            return Said(f"{quality['status']}, {quality['confidence']['level']}", warnings)
        found = json.loads((work / "evidence/findings.json").read_text())
        return Said(
            "low" if any(finding["severity"] in ("warning", "error") for finding in found) else "goes on", warnings
        )


def mistakes_on(inputs: Inputs, others: Sequence[Inputs]) -> dict[str, Inputs]:
    """Every mistake that can be made on these inputs."""
    made = {name: mistake(inputs) for name, mistake in MISTAKES.items()}
    other = next(filter(inputs.is_comparable, others), None)
    if other is not None:
        made[OTHER_OBJECT] = replace(inputs, images=other.images, angles=other.angles, mask=other.mask)
    return made


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("stations", nargs="+", type=Path)
    parser.add_argument("--until", choices=["evidence", "assess"], default="assess")
    parser.add_argument("--only", nargs="+", metavar="MISTAKE", choices=[*MISTAKES, OTHER_OBJECT])
    args = parser.parse_args()
    stations = {path: read(path) for path in args.stations}
    ends: dict[str, collections.Counter[str]] = collections.defaultdict(collections.Counter)
    for number, (path, inputs) in enumerate(stations.items()):
        print(path)
        others = [*list(stations.values())[number + 1 :], *list(stations.values())[:number]]
        for name, made in mistakes_on(inputs, others).items():
            if args.only and name not in args.only:
                continue
            said = run(made, args.until)
            ends[name][said.end if said.words else f"{said.end}, silent"] += 1
            print(f"  {name}: {said.end}", flush=True)
            for words in said.words:
                print(f"    {words}", flush=True)
    print(f"{len(stations)} stations")
    for name, counts in ends.items():
        print(f"  {name}: " + ", ".join(f"{end}: {count}" for end, count in counts.items()))


if __name__ == "__main__":
    main()
