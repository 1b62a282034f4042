"""Metashape Professional 2.x: Tools > Run Script. Exports the active chunk for a station of Malus, and writes the station file.

Written after the reference of Metashape 2.1 and NOT tested in it; the tests run it with a stand-in for Metashape. The same can be done
by hand: export cameras.xml and the point cloud in local coordinates, then run `malus import` with both.
"""

import shutil
import subprocess
from pathlib import Path

import Metashape


def unfit(chunk):
    """Why the chunk cannot be exported; None if it can."""
    if chunk is None or chunk.point_cloud is None:
        return "The active chunk has no point cloud: build one first (Workflow > Build Point Cloud)."
    if not chunk.transform.scale:
        return "The active chunk has no scale: add a scale bar or markers of known place, and update the transform."
    # In other coordinate systems the cloud would be written in degrees, or in another frame than the cameras.
    if chunk.crs is not None and not chunk.crs.wkt.startswith("LOCAL_CS"):
        return "The chunk lies on the Earth: choose Local Coordinates in the Reference pane's settings first."
    return None


def export_station():
    """Ask for the folder of polarized images and the station's camera; export cameras and cloud beside it and write the station file."""
    chunk = Metashape.app.document.chunk
    malus = shutil.which("malus")
    reason = unfit(chunk) or (None if malus else "The program malus is not on the PATH of Metashape.")
    if reason:
        Metashape.app.messageBox(reason)
        return
    folder = Metashape.app.getExistingDirectory("Folder of the images through the polarizer")
    if not folder:
        return
    label = Metashape.app.getString("Label of the station's camera in this chunk", "station.jpg")
    if not label:
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
    words = {"-o": station, "--metashape": cameras, "--label": label, "--cloud": cloud, "--unit": "m"}
    options = [str(word) for pair in words.items() for word in pair]
    told = subprocess.run([malus, "import", folder, *options], capture_output=True, text=True)
    Metashape.app.messageBox(told.stderr if told.returncode else told.stdout)


export_station()
