"""Metashape Professional 2.x: Tools > Run Script. Exports the active chunk for a station of Malus, and writes the station file.

Written after the reference of Metashape 2.1 and NOT tested in it. What it does by hand: export cameras.xml and the point cloud in the
chunk's own coordinates, then `malus import` with both.
"""

import shutil
import subprocess
from pathlib import Path

import Metashape


def export_station():
    """Ask for the folder of polarized images and the station's camera, export what Malus needs beside it."""
    chunk = Metashape.app.document.chunk
    if chunk is None or chunk.point_cloud is None:
        Metashape.app.messageBox("The active chunk has no point cloud: build one, and set the scale, first.")
        return
    malus = shutil.which("malus")
    if malus is None:
        Metashape.app.messageBox("The program malus is not on the PATH of Metashape.")
        return
    folder = Metashape.app.getExistingDirectory("Folder of the images through the polarizer")
    label = Metashape.app.getString("Label of the station's camera in this chunk", "station.jpg")
    if not folder or not label:
        return
    here = Path(folder).parent
    cameras, cloud, station = here / "cameras.xml", here / "cloud.ply", here / "station.toml"
    chunk.exportCameras(str(cameras), format=Metashape.CamerasFormatXML)
    chunk.exportPointCloud(
        str(cloud),
        source_data=Metashape.PointCloudData,
        format=Metashape.PointCloudFormatPLY,
        save_point_normal=True,
        save_point_color=True,
    )
    told = subprocess.run(
        [
            malus,
            "import",
            folder,
            "-o",
            station,
            "--metashape",
            cameras,
            "--label",
            label,
            "--cloud",
            cloud,
            "--unit",
            "m",
        ],
        capture_output=True,
        text=True,
    )
    Metashape.app.messageBox(told.stdout or told.stderr)


export_station()
