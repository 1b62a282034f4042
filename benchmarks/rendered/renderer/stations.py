"""Writes the station files of a rendered scene.

station.toml         low noise (16 frames averaged), camera and coarse cloud given
station_noisy.toml   single frames, misregistered, camera and coarse cloud given
station_goodprior.toml, station_jpeg.toml, station_distorted.toml   if the scene has these inputs
station_photos.toml  low noise; Malus computes the coarse surface from the photographs, and the scale from marked targets
object.toml          for scenes with several stations
"""

import json
from pathlib import Path

import numpy as np

q = json.dumps


def _polarized(meta, folder, pol, ext, response, frames):
    s = meta["sensor"]
    out = [
        "[station]",
        f"name = {q(meta['name'])}",
        'unit = "mm"',
        "",
        "[polarized]",
        "images = " + q([f"pol/{pol}/pol_{a:03d}.{ext}" for a in meta["angles_deg"]]),
        f"angles_deg = {q(meta['angles_deg'])}",
        'angle_direction = "ccw"',
        f'response = "{response}"',
        f"frames_averaged = {frames}",
        f"full_well_e = {s['full_well_e']:g}",
        f"read_noise_e = {s['read_noise_e']:g}",
    ]
    if response == "linear":
        out.append(f"white_level = {s['white_level_dn']}")
    if (folder / "mask.png").exists():
        out.append('mask = "mask.png"')
    index = meta["material"].get("refractive_index")
    return out + [
        "",
        "[optics]",
        f"refractive_index = {index if isinstance(index, (int, float)) else 1.5}",
        'reflection = "auto"',
        "",
        "[camera]",
    ]


def _pinhole(c):
    K = np.array(c["K"])
    return f"[{K[0, 0]:.6f}, {K[1, 1]:.6f}, {K[0, 2] + 0.5:.6f}, {K[1, 2] + 0.5:.6f}]"


def _scale(meta):
    """[[scale]] tables: the ends of the known distances marked in every second photo, with an error of 0.15 px."""
    rng, out = np.random.default_rng(7), []
    for name, distance in meta["scale_distances_mm"].items():
        ends = []
        for end in name.split("-"):
            X, marks = np.array(meta["scale_points"][end]["world"]), []
            for v in meta["views"][::2]:
                p = np.array(v["R_world_to_cam"]) @ X + np.array(v["t_world_to_cam"])
                x, y = (np.array(v["K"]) @ (p / p[2]))[:2] + rng.normal(0, 0.15, 2)
                if 5 < x < v["width"] - 5 and 5 < y < v["height"] - 5:
                    marks.append(f'  {{ image = "{v["name"]}", x = {x:.2f}, y = {y:.2f} }},')
            ends.append(marks)
        if min(map(len, ends)) >= 2:
            out += ["", "[[scale]]", f"distance = {distance:.4f}", "a = [", *ends[0], "]", "b = [", *ends[1], "]"]
    return out


def write(
    folder,
    meta,
    name,
    pol="lownoise",
    cloud="mvs_cloud.ply",
    model="gt_sparse",
    ext="png",
    response="linear",
    frames=16,
    photos=False,
):
    up = meta["shared_folder"]
    out = _polarized(meta, folder, pol, ext, response, frames)
    if photos:
        s, v = meta["station"], meta["views"][0]
        out += [
            'model = "PINHOLE"',
            f"width = {s['width']}",
            f"height = {s['height']}",
            f"params = {_pinhole(s)}   # COLMAP order and pixel convention",
            "",
            "[photos]",
            'folder = "views"',
            f"exclude = [{q(meta['station_image'])}]",
        ]
        if not meta.get("photos_self_calibrate"):  # flat scenes and long lenses: self-calibration is degenerate
            out.append(
                f'camera = {{ model = "PINHOLE", width = {v["width"]}, height = {v["height"]}, params = {_pinhole(v)} }}'
            )
        out += _scale(meta)
    else:
        out += [
            f'colmap_model = "{up}{model}"',
            f'image = "{meta["station_image"]}"',
            "",
            "[prior]",
            f'cloud = "{up}dense/{cloud}"',
        ]
    for p in meta["flat_patches"]:
        out += ["", "[[patch]]", f"name = {q(p['name'])}", f"box = {p['box_xyxy']}"]
    (folder / name).write_text("\n".join(out) + "\n")


def write_all(folder, meta):
    """Writes all station files for which this folder has the images."""
    base = folder / meta["shared_folder"]
    write(folder, meta, "station.toml")
    if "noisy_misreg" in meta["pol_sets"]:
        write(folder, meta, "station_noisy.toml", "noisy_misreg", frames=1)
    if (base / "dense/mvs_cloud_good.ply").exists():
        write(folder, meta, "station_goodprior.toml", cloud="mvs_cloud_good.ply")
    if "jpeg8" in meta["pol_sets"]:
        write(folder, meta, "station_jpeg.toml", "jpeg8", ext="jpg", response="srgb", frames=1)
    if "distorted" in meta["pol_sets"]:
        write(folder, meta, "station_distorted.toml", "distorted", model="gt_sparse_distorted")
    if not meta["shared_folder"]:
        write(folder, meta, "station_photos.toml", photos=True)


def write_object(path: Path, name, folders):
    path.write_text(f"[object]\nname = {q(name)}\nstations = {q([f + '/station.toml' for f in folders])}\n")
