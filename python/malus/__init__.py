"""Malus: surfaces of heritage objects from shape from polarization fused with multi-view stereo.

    import malus
    station = malus.Station.load("station.toml")
    result = malus.reconstruct(station, malus.Options(fusion="refined"))
    result.depth, result.normals, result.sigma

Frames, angles and units: docs/conventions.md. Each step alone, on arrays: `malus.polarization`, `malus.capture`,
`malus.stereo`, `malus.prior`, `malus.evidence`, `malus.height`, `malus.fusion`, `malus.surface`, `malus.assess`.
"""

from malus import assess, capture, evidence, fusion, height, photogrammetry, polarization, prior, stereo, surface
from malus._core import version as __version__
from malus.camera import Camera
from malus.errors import DataError, ExternalError, InputError, MalusError, ResourceError
from malus.exports import export
from malus.object import Object
from malus.options import Options
from malus.reconstruction import Progress, Result, check, reconstruct
from malus.report import open_report, write_report
from malus.station import Station
from malus.station_import import import_station
from malus.workspace import Workspace

__all__ = [
    "Camera",
    "DataError",
    "ExternalError",
    "InputError",
    "MalusError",
    "Object",
    "Options",
    "Progress",
    "ResourceError",
    "Result",
    "Station",
    "Workspace",
    "__version__",
    "assess",
    "capture",
    "check",
    "evidence",
    "export",
    "fusion",
    "height",
    "import_station",
    "open_report",
    "photogrammetry",
    "polarization",
    "prior",
    "reconstruct",
    "stereo",
    "surface",
    "write_report",
]
