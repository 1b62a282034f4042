"""Photogrammetric front end: ordinary photos in, the station's place, metric scale and depth in its view out.

COLMAP (Debian's 3.8, or pycolmap 4.2 or later) finds the cameras as a child process; scale comes from known distances. `malus.reconstruct`
runs it for stations with [photos] and no [prior]; `find_cameras` and `sweep_station` are its two halves, `plan` says what they would do. `read_metashape`
reads the cameras of an Agisoft Metashape project.
"""

from malus.photogrammetry.folder import exclusive
from malus.photogrammetry.front_end import (
    FusedOnce,
    StationCameras,
    Swept,
    find_cameras,
    find_object_cameras,
    sweep_station,
)
from malus.photogrammetry.metashape import read_metashape
from malus.photogrammetry.model import RegisteredImage, SparseModel
from malus.photogrammetry.photos import Photo, list_photos
from malus.photogrammetry.plan import plan

__all__ = [
    "FusedOnce",
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
