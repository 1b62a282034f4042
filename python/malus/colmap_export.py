"""The surface as one image of a COLMAP dense workspace, so that photogrammetry programs can continue from it.

`colmap stereo_fusion`, `colmap poisson_mesher` and the importers of OpenMVS and Meshroom read it. It contains an undistorted image, its
camera and pose, and depth and normal maps in the form in which COLMAP's patch match writes them.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from malus._files import new_folder
from malus.workspace import Workspace
from malus.xmp import save_png


def write_map(path: Path, values: NDArray[np.float32]) -> None:
    """A depth or normal map (H×W or H×W×C) in COLMAP's binary form; 0 = none."""
    channels = np.nan_to_num(values.astype("<f4")).reshape(*values.shape[:2], -1)
    height, width, count = channels.shape
    with path.open("wb") as file:
        file.write(f"{width}&{height}&{count}&".encode())
        file.write(np.ascontiguousarray(channels.transpose(2, 0, 1)).tobytes())


def write_colmap_workspace(workspace: Workspace, picture: NDArray[np.uint8], xmp: str, folder: Path) -> Path:
    """Write a COLMAP dense workspace with the station as its only image; returns the folder, which must not exist yet."""
    surface, camera = workspace.surface(), workspace.camera
    name = "station.png"
    with new_folder(folder) as new:
        for part in ("images", "sparse", "stereo/depth_maps", "stereo/normal_maps", "stereo/consistency_graphs"):
            (new / part).mkdir(parents=True)
        save_png(new / "images" / name, picture, xmp)
        for model in ("camera", "image"):
            text = workspace.path(f"fused/{model}.txt").read_text(encoding="utf-8")
            if model == "image":
                # COLMAP has two lines per image: the image, and its points, of which there are none here.
                words = next(line for line in text.splitlines() if line and not line.startswith("#")).split()
                text = " ".join([*words[:9], name]) + "\n\n"
            (new / f"sparse/{model}s.txt").write_text(text, encoding="utf-8")
        (new / "sparse/points3D.txt").write_text("", encoding="utf-8")
        (new / "stereo/fusion.cfg").write_text(f"{name}\n", encoding="utf-8")
        (new / "stereo/patch-match.cfg").write_text(f"{name}\n__auto__, 20\n", encoding="utf-8")
        assert surface.depth.shape == (camera.height, camera.width)
        for kind in ("geometric", "photometric"):
            write_map(new / f"stereo/depth_maps/{name}.{kind}.bin", surface.depth)
            write_map(new / f"stereo/normal_maps/{name}.{kind}.bin", surface.normals)
    return folder
