"""Photogrammetric front end: from ordinary photos to the station's pose, the metric scale and the depth in the station's view.

COLMAP (Debian's 3.8, or pycolmap 4.2 or later) finds the cameras in a child process; the scale comes from known distances.
`malus.reconstruct` runs the front end for stations with [photos] and no [prior]. `find_cameras` and `sweep_station` are its two halves,
`plan` tells in advance what they would do. `read_metashape` reads the cameras of an Agisoft Metashape project.
"""

from malus.photogrammetry.folder import exclusive
from malus.photogrammetry.front_end import Outline, StationCameras, find_cameras, find_object_cameras
from malus.photogrammetry.metashape import read_metashape
from malus.photogrammetry.model import RegisteredImage, SparseModel
from malus.photogrammetry.photos import Photo, list_photos
from malus.photogrammetry.plan import plan
from malus.photogrammetry.station_sweep import FusedOnce, Swept, sweep_station

__all__ = [
    "FusedOnce",
    "Outline",
    "Photo",
    "RegisteredImage",
    "SparseModel",
    "StationCameras",
    "Swept",
    "exclusive",
    "find_cameras",
    "find_object_cameras",
    "list_photos",
    "plan",
    "read_metashape",
    "sweep_station",
]
