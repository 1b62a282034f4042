"""Malus: surfaces of heritage objects from shape from polarization fused with multi-view stereo.

    import malus
    station = malus.Station.load("station.toml")
    result = malus.reconstruct(station, malus.Options(fusion="refined"))
    result.depth, result.normals, result.sigma

Frames, angles and units: docs/conventions.md. Modules that run single steps on arrays: `malus.polarization`, `malus.capture`,
`malus.stereo`, `malus.prior`, `malus.evidence`, `malus.height`, `malus.fusion`, `malus.surface`, `malus.assess`.
"""

from malus import _memory

_memory.prepare()

from malus import assess, capture, evidence, fusion, height, photogrammetry, polarization, prior, stereo, surface  # noqa: E402
from malus._core import version as __version__  # noqa: E402
from malus.camera import Camera  # noqa: E402
from malus.change import Change, compare  # noqa: E402
from malus.errors import DataError, ExternalError, InputError, MalusError, ResourceError  # noqa: E402
from malus.exports import export  # noqa: E402
from malus.object import Object  # noqa: E402
from malus.options import Options  # noqa: E402
from malus.paper import merge_campaign, write_paper  # noqa: E402
from malus.planning import check  # noqa: E402
from malus.reconstruction import Progress, reconstruct  # noqa: E402
from malus.report import open_report, write_report  # noqa: E402
from malus.result import Confidence, Result  # noqa: E402
from malus.station import Station  # noqa: E402
from malus.station_import import import_station  # noqa: E402
from malus.workspace import Workspace  # noqa: E402

__all__ = [
    "Camera",
    "Change",
    "Confidence",
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
    "compare",
    "evidence",
    "export",
    "fusion",
    "height",
    "import_station",
    "merge_campaign",
    "open_report",
    "photogrammetry",
    "polarization",
    "prior",
    "reconstruct",
    "stereo",
    "surface",
    "write_paper",
    "write_report",
]
