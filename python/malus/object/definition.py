"""Object files: the stations of one object, and what is wanted of its surface."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from malus.campaign import Campaign, options_of, read_tables, stations_of, value_of
from malus.errors import InputError
from malus.options import Options
from malus.reconstruction import check
from malus.station import Station

_KEYS = {
    "": ("object", "options"),
    "object": ("name", "unit", "stations", "report", "closed", "max_sigma_gsd", "faces"),
}
#: Triangles of the textured mesh.
_FACES = 20000.0
_LEAST_FACES = 100


@dataclass(frozen=True)
class Object:
    """Stations about one object, in one frame and unit.

    closed: the mesh has no holes; where nobody looked it is a guess, marked so. Otherwise it is open there, and where its standard
    deviation exceeds max_sigma_gsd GSD. faces: triangles of the textured mesh (object/mesh.glb), at most about.
    """

    campaign: Campaign
    unit: str
    closed: bool = False
    max_sigma_gsd: float = 4.0
    faces: int = int(_FACES)

    @property
    def name(self) -> str:
        """The object's name."""
        return self.campaign.name

    @staticmethod
    def load(path: str | Path) -> Object:
        """Read an object file; InputError names file, field, value and what was expected.

        [object] has `stations`, a list of station files or globs relative to the file, and optionally `name`, `unit` (that all
        stations must have), `report`, `closed`, `max_sigma_gsd` and `faces`. [options] is what `--options` takes. All stations
        must stand in one frame: poses of one COLMAP model, or given in the same coordinates.
        """
        file = Path(path)
        content = read_tables(file, _KEYS)
        table = content.get("object")
        if not isinstance(table, dict):
            raise InputError(f"{file}: there is no table [object]")

        def value(key: str, default: Any) -> Any:
            return value_of(file, "object", table, key, default)

        limit, faces = value("max_sigma_gsd", 4.0), value("faces", _FACES)
        if not limit > 0:
            raise InputError(f"{file}: object.max_sigma_gsd = {limit:g}, expected more than 0")
        if not faces >= _LEAST_FACES:
            raise InputError(f"{file}: object.faces = {faces:g}, expected at least {_LEAST_FACES}")
        files = stations_of(file, "object", table)
        campaign = Campaign(value("name", file.stem), files, options_of(file, content), value("report", True))
        unit = _common_unit(file, files, value("unit", ""))
        return Object(campaign, unit, value("closed", False), limit, int(faces))

    def check(self, options: Options | None = None, *, threads: int = 1) -> list[dict[str, Any]]:
        """What `malus.check` says of each station."""
        return [
            check(Station.load(path), options or self.campaign.options, threads=threads)
            for path in self.campaign.stations
        ]


def is_object_file(path: str | Path) -> bool:
    """Whether a file is an object file rather than a station file; False also if it cannot be read."""
    try:
        table = tomllib.loads(Path(path).read_text(encoding="utf-8")).get("object")
    except (OSError, ValueError, RecursionError):
        return False
    # A station file has a table of this name, too: what the catalogue says.
    return isinstance(table, dict) and "stations" in table


def _common_unit(file: Path, stations: Sequence[Path], expected: str) -> str:
    """The unit of all stations, which must stand in one frame to be joined."""
    for path in stations:
        station = Station.load(path).describe()
        if "camera" not in station:
            raise InputError(
                f"{path}: [camera] is missing; the stations of an object must stand in one frame, expected colmap_model and image, or a pose"
            )
        if station["prior"] == "photos":
            raise InputError(
                f"{path}: [prior] is missing; each station would place itself in a frame of its own, expected the cloud that all stations of the object share"
            )
        expected = expected or station["unit"]
        if station["unit"] != expected:
            raise InputError(f"{path}: station.unit = {station['unit']!r}, expected {expected!r} as the rest of {file}")
    return expected
