"""Small stations of random objects under random light, with exact truth, for `harm.py`.

    RENDERER/venv/bin/python benchmarks/random_stations.py -o OUT [--renderer RENDERER] [--count 200] [--first 0] [--seed 1]

RENDERER: the folder of the path tracer, by default rendered/renderer (its README says how to install it); run this file with its
interpreter. For each station the following are drawn, from --seed and the station's number alone: the scene and the object's own seed;
the light; the roughness and refractive index of dielectrics, and whether the station file has the true index or 1.5; full well and read
noise of the sensor; the noise of the coarse cloud. Metals keep their material. Each folder OUT/NNN_SCENE_LIGHT is written by
`render.py`; random.json with the drawn values, --scale and --quality is written last. A folder with random.json is complete and is not
changed; if it was made with other arguments, the program ends.
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Description = dict[str, Any]  # of a scene, as the renderer's scenes/__init__.py has it

# Relative frequency of each scene. Metals and the figurine, of which only one station is used, are drawn half as often.
SCENES = {
    "relief": 2, "coin": 2, "glassy": 2, "bust": 2, "painting": 2, "tablet": 2, "ceramic": 2,
    "figurine": 1, "bronze": 1, "coin_metal": 1,
}  # fmt: skip
LIGHTS = ("constant", "sun", "softbox", "softboxes", "room", "raking")
SIZE, FIGURINE_SIZE = (200, 150), (160, 200)
# Photographs are taken up to 27° from the station's direction and see 10° to either side: no lamp may block their view.
PHOTOS_SEE_DEG = 37.0
ROUGHNESS, INDEX = (0.03, 0.5), (1.3, 2.0)


def log_uniform(random: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(random.uniform(np.log(low), np.log(high))))


def towards_station(station: dict[str, Any]) -> Vector:
    """World direction from the object to the station's camera, as in the renderer's cameras.station_camera."""
    if "direction" in station:
        direction = np.array(station["direction"], float)
    else:
        about_x, about_y = np.radians(station["tilt"])
        direction = np.array([np.sin(about_y), -np.sin(about_x), 1.0])
    return np.asarray(direction / np.linalg.norm(direction))


def frame_about(axis: Vector) -> Vector:
    """A rotation whose rows are two directions across the axis, and the axis."""
    across = np.cross([0.0, 1.0, 0.0] if abs(axis[1]) < 0.9 else [1.0, 0.0, 0.0], axis)
    across /= np.linalg.norm(across)
    return np.stack([across, np.cross(axis, across), axis])


class RandomLight:
    """Draws the light for one object, from the object's position and size and the cameras' positions."""

    def __init__(self, lights: Any, sc: Description, random: np.random.Generator) -> None:
        points = np.concatenate([m["V"] for m in sc["meshes"] if m["label"] == 1])
        low, high = points.min(0), points.max(0)
        station = sc["stations"][0]
        self.lights, self.random = lights, random
        self.center, self.radius = (low + high) / 2, float(np.linalg.norm(high - low) / 2)
        self.camera_distance = 1.1 * max(float(station["dist"]), float(sc["views"]["dist"]))
        self.facing, self.upright = towards_station(station), "direction" in station

    def direction(self, zenith_deg: tuple[float, float]) -> tuple[Vector, float]:
        """Unit vector to a light, and its angle [deg] from the direction to the station."""
        zenith, azimuth = np.radians(self.random.uniform(*zenith_deg)), self.random.uniform(0, 2 * np.pi)
        local = [np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), np.cos(zenith)]
        d = np.array(local) @ frame_about(self.facing)
        height = 1 if self.upright else 2
        d[height] = max(abs(d[height]), 0.1)  # not below the support
        d /= np.linalg.norm(d)
        return d, float(np.degrees(np.arccos(np.clip(d @ self.facing, -1, 1))))

    def softbox(self, zenith_deg: tuple[float, float]) -> tuple[list[Any], dict[str, Any]]:
        """A lamp that gives a surface facing it an irradiance of about pi."""
        d, zenith = self.direction(zenith_deg)
        side_per_distance = log_uniform(self.random, 0.12, 0.8)
        distance = self.radius * log_uniform(self.random, 3, 15)
        if zenith - np.degrees(np.arctan(side_per_distance / 2)) < PHOTOS_SEE_DEG:
            distance = max(distance, 1.5 * self.camera_distance)
        side = side_per_distance * distance
        box = self.lights.softbox(
            self.center + d * distance, (side, side), np.pi / side_per_distance**2, target=tuple(map(float, self.center)),
            up=(1, 0, 0) if abs(d[1]) > 0.9 else (0, 1, 0),
        )  # fmt: skip
        return [box], dict(to_light=d.tolist(), zenith_deg=zenith, distance=distance, side=side)

    def constant(self) -> tuple[list[Any], dict[str, Any]]:
        # Mitsuba needs at least one light that is sampled explicitly; lights.constant is not.
        return [dict(type="constant", radiance=1.0)], {}

    def sun(self) -> tuple[list[Any], dict[str, Any]]:
        d, zenith = self.direction((15, 70))
        sky = log_uniform(self.random, 0.02, 0.4)
        drawn = dict(to_light=d.tolist(), zenith_deg=zenith, sky=sky)
        return [self.lights.directional(d, np.pi), self.lights.constant(sky)], drawn

    def lamps(self, zenith_deg: tuple[float, float], number: int) -> tuple[list[Any], dict[str, Any]]:
        ambient = log_uniform(self.random, 0.01, 0.2)
        boxes = [self.softbox(zenith_deg) for _ in range(number)]
        sources = [source for box, _ in boxes for source in box]
        return [*sources, self.lights.constant(ambient)], dict(boxes=[drawn for _, drawn in boxes], ambient=ambient)

    def room(self) -> tuple[list[Any], dict[str, Any]]:
        """Gray walls that are brighter on one side, and a window."""
        d, zenith = self.direction((20, 80))
        to_window = frame_about(d)[[2, 0, 1]]
        width, height = self.random.uniform(15, 60, 2)
        window, slope = log_uniform(self.random, 3, 30), self.random.uniform(0, 0.8)
        wall = self.direction((0, 180))[0]

        def radiance(directions: Vector) -> Vector:
            walls = 0.3 * (1 + slope * directions @ wall)
            shape = self.lights.rectangle_in_room(directions @ to_window.T, 0.0, 0.0, width, height, 1.5)
            return np.asarray(walls + (window - walls) * shape)

        drawn = dict(to_light=d.tolist(), zenith_deg=zenith, width_deg=width, height_deg=height, window=window)
        return [self.lights.room(radiance)], drawn

    def draw(self, kind: str) -> tuple[list[Any], dict[str, Any]]:
        """Mitsuba's emitters, and the drawn values."""
        kinds: dict[str, Callable[[], tuple[list[Any], dict[str, Any]]]] = {
            "constant": self.constant,
            "sun": self.sun,
            "softbox": lambda: self.lamps((15, 70), 1),
            "softboxes": lambda: self.lamps((15, 70), 2),
            "room": self.room,
            "raking": lambda: self.lamps((70, 82), 1),
        }
        return kinds[kind]()


def draw_material(sc: Description, random: np.random.Generator) -> dict[str, Any]:
    """Draw roughness and refractive index of a dielectric object, and the index that the station file states."""
    objects = [m for m in sc["meshes"] if m["label"] == 1]
    if any(m["bsdf"]["type"] != "pplastic" for m in objects):
        return dict(metal=True)
    index, known = float(random.uniform(*INDEX)), bool(random.random() < 0.5)
    alphas = [log_uniform(random, *ROUGHNESS) for _ in objects]
    for mesh, alpha in zip(objects, alphas, strict=True):
        mesh["bsdf"] = dict(mesh["bsdf"], int_ior=index, alpha=alpha)
    said = round(index, 3) if known else 1.5
    sc["material"] = dict(sc["material"], refractive_index=said, true_refractive_index=index, roughness_alpha=alphas)
    return dict(metal=False, roughness=alphas, refractive_index=index, index_said=said)


def changed_scene(module: Any, lights: Any, light: str, random: np.random.Generator, drawn: dict[str, Any]) -> Any:
    """A scene module for the renderer: `module` with drawn station, material, light and cloud noise, which are recorded in `drawn`."""

    def scene(style: Any, rng: np.random.Generator, quality: float) -> Description:
        sc: Description = module.scene(style, rng, quality)
        sc["stations"] = [sc["stations"][random.integers(len(sc["stations"]))]]
        for unused in ("jpeg", "distortion", "truth_mesh"):
            sc.pop(unused, None)
        drawn.update(draw_material(sc, random))
        sc["lights"], drawn["light_drawn"] = RandomLight(lights, sc, random).draw(light)
        # The renderer hides a gallery's walls behind the object; the station does not see the difference.
        sc["light_meta"] = dict(kind=light, **drawn["light_drawn"])
        drawn["cloud_noise_factor"] = log_uniform(random, 0.6, 1.8)
        sc["mvs"] = dict(sc["mvs"], noise=sc["mvs"]["noise"] * drawn["cloud_noise_factor"])
        return sc

    return SimpleNamespace(scene=scene, STYLES=module.STYLES)


def import_untyped(name: str) -> Any:
    return importlib.import_module(name)


def render_one(
    seed: int, number: int, out: Path, quality: float, scale: int, photos: int, chances: dict[str, int]
) -> bool:
    """Render station `number`, its images `scale` times as wide and high as SIZE; False if it exists already.

    photos: how many photographs are taken, see main().

    Ends the program if it was made with other arguments: so were the others, of which each would be such an error.
    """
    # The renderer's modules; its own interpreter finds them only once --renderer is known.
    render, lights, noise, scenes = map(import_untyped, ("render", "lights", "noise", "scenes"))
    random = np.random.default_rng([seed, number])
    weights = np.array(list(chances.values()), float)
    name = str(random.choice(list(chances), p=weights / weights.sum()))
    light, object_seed = str(random.choice(LIGHTS)), int(random.integers(1, 4_000_000))
    record = out / f"{number:03d}_{name}_{light}" / "random.json"
    noise.FULL_WELL_E, noise.READ_NOISE_E = log_uniform(random, 6000, 40000), log_uniform(random, 3, 20)
    drawn = dict(seed=seed, number=number, scene=name, light=light, object_seed=object_seed, scale=scale,
                 quality=quality, photos=photos, full_well_e=noise.FULL_WELL_E, read_noise_e=noise.READ_NOISE_E)  # fmt: skip
    if record.exists():
        present = json.loads(record.read_text())
        if other := [key for key, value in drawn.items() if present.get(key) != value]:
            raise SystemExit(f"{record.parent}: was not made with this {', '.join(other)}, expected another --output")
        return False
    # scenes.SCENES is not changed: the next station starts from it again.
    render.SCENES = {name: changed_scene(scenes.SCENES[name], lights, light, random, drawn)}
    width, height = FIGURINE_SIZE if name == "figurine" else SIZE
    size, view_size = f"{scale * width}x{scale * height}", f"{scale * 300}x{scale * 200}"
    sys.argv = ["render.py", "--scene", name, "--seed", str(object_seed), "--size", size, "--view-size", view_size,
                "--views", str(photos or 3), "--view-spp", "24" if photos else "6", "--quality", str(quality),
                "--noisy", "all", "--no-components", "--out", str(record.parent)]  # fmt: skip
    if light == "constant":  # rays hit this light only by chance: four times the usual samples
        sys.argv += ["--spp", "576"]
    render.main()
    record.write_text(json.dumps(drawn, indent=1) + "\n")
    return True


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--renderer", type=Path, default=Path(__file__).parent / "rendered" / "renderer")
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--quality", type=float, default=0.4, help="mesh density, as render.py's")
    parser.add_argument("--scale", type=int, default=1, help="images this many times as wide and as high; 3, with --quality 1, is the "
                        "size of render.py's own stations")  # fmt: skip
    parser.add_argument("--photos", type=int, default=0, help="how many photographs are taken, from which the coarse "
                        "surface can be made, e.g. 10; 0 = a few noisy ones that nothing is made from")  # fmt: skip
    parser.add_argument("--scenes", nargs="+", metavar="SCENE", help="draw among these alone, with equal chances")
    args = parser.parse_args()
    if args.scale < 1:
        parser.error(f"--scale {args.scale}: expected 1 or more")
    if not (args.renderer / "render.py").exists():
        parser.error(f"--renderer {args.renderer}: expected a folder with render.py")
    sys.path.insert(0, str(args.renderer.resolve()))
    chances = dict.fromkeys(args.scenes, 1) if args.scenes else SCENES
    failed = []
    for number in range(args.first, args.first + args.count):
        try:
            render_one(args.seed, number, args.output, args.quality, args.scale, args.photos, chances)
        except Exception:  # an object that cannot be rendered does not stop the other stations
            traceback.print_exc()
            failed.append(number)
    print(f"{args.count - len(failed)} stations in {args.output}" + (f"; failed: {failed}" if failed else ""))
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
