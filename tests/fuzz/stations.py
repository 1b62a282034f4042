"""Seeds for station files and object files: every table and most keys; and the files that they name, as parsers.cpp has them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

_IMAGES = """[polarized]
images = ["pol/pol_000.png", "pol/pol_060.png", "pol/pol_120.png"]
angles_deg = [0, 60, 120]
angle_direction = "cw"
angle_zero_deg = 40.0
exposure_s = [0.1, 0.1, 0.1]
channel = "luminance"
response = "response.txt"
white_level = 255
black_level = 1
frames_averaged = 4
full_well_e = 20000
read_noise_e = 8
mask = "mask.png"
curve_pixels = [[1, 2]]

[optics]
refractive_index = "auto"
reflection = "specular"
metal = [0.7, 2.6]
light = [0.1, 0.0, -1.0]
"""
_POSE = """
[camera]
model = "OPENCV"
width = 8
height = 6
params = [50, 50, 4, 3, 0.01, 0, 0, 0]
qvec = [1, 0, 0, 0]
tvec = [0, 0, 1]
"""
_LENS = """
[camera]
model = "PINHOLE"
width = 8
height = 6
params = [50, 50, 4, 3]
"""
_PHOTOS = """
[photos]
folder = "views"
masks = "masks"
camera = { model = "PINHOLE", width = 8, height = 6, params = [50, 50, 4, 3] }
"""
_DISTANCES = """
[[scale]]
distance = 31.5
a = [ { image = "a.png", x = 1.5, y = 2 }, { image = "b.png", x = 3, y = 2 } ]
b = [ { image = "a.png", x = 6.5, y = 2 }, { image = "b.png", x = 5, y = 4 } ]

[[scale]]
distance = 10
targets = [3, 7]
targets_dictionary = "aruco_4x4_50"
check = true
"""
_POINTS = "".join(
    f"""
[[control]]
name = "P{k}"
xyz = [{k % 2}, {k // 2}, {k * k}]
marks = [ {{ image = "a.png", x = {k}, y = 2 }}, {{ image = "b.png", x = 3, y = {k} }} ]
check = {"true" if k == 3 else "false"}
"""
    for k in range(4)
)
#: Name → station file.
STATIONS = {
    "cloud": '[station]\nname = "a"\nunit = "mm"\n\n'
    + _IMAGES
    + _POSE
    + """
[prior]
cloud = "cloud.ply"
sigma = 0.1

[object]
title = "Stone"
license = "CC0"

[[scale]]
distance = 2.0
a_xyz = [0, 0, 0]
b_xyz = [1, 0, 0]

[[patch]]
name = "label"
box = [1, 1, 4, 4]

[[profile]]
name = "1"
from = [1, 2]
to = [6, 3]
""",
    "distances": _IMAGES + _LENS + _PHOTOS + _DISTANCES,
    "points": _IMAGES + _LENS + _PHOTOS + _POINTS,
    "mosaic": """[polarized]
images = ["pol/pol_000.png"]
mosaic = [[90, 45], [135, 0]]

[camera]
model = "BROWN"
width = 8
height = 6
focal_mm = 50
pixel_mm = 1.0
x0_mm = 0.1
y0_mm = 0
k1 = 1e-4
k2 = 0
k3 = 0
p1 = 0
p2 = 0
omega_phi_kappa_deg = [1, 2, 3]
center = [0, 0, 10]

[prior]
sphere = { center = [0, 0, 0], radius = 3 }
sigma = 0.1
""",
}
#: Name → object file.
OBJECTS = {
    "distances": '[object]\nstations = ["station.toml"]\nclosed = true\nfaces = 1000\ntexture_format = "jpeg"\n'
    "turntable = true\n" + _PHOTOS + _DISTANCES,
    "points": '[object]\nname = "b"\nunit = "mm"\nstations = ["stat*.toml"]\nreport = false\nmax_sigma_gsd = 3\n'
    'reference = "cloud.ply"\nregister = false\n' + _PHOTOS + _POINTS + '\n[options]\nfusion = "grid"\n',
}


def write_inputs(folder: Path) -> None:
    """Write the files that the seeds name, and a station file."""
    for name in ("pol/pol_000", "pol/pol_060", "pol/pol_120", "mask", "views/a", "views/b", "masks/a", "masks/b"):
        path = folder / f"{name}.png"
        path.parent.mkdir(exist_ok=True)
        Image.fromarray(np.full((6, 8), 255, np.uint8)).save(path)
    properties = "".join(f"property float {axis}\n" for axis in "xyz")
    (folder / "cloud.ply").write_text(f"ply\nformat ascii 1.0\nelement vertex 1\n{properties}end_header\n0 0 1\n")
    (folder / "response.txt").write_text("0 0\n255 1\n")
    (folder / "station.toml").write_text(_IMAGES + _LENS + _PHOTOS)
