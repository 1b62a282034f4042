"""Fuzzes Python's readers of users' files with atheris: EXIF, RAW, LAS, E57, tables and notes beside images, cameras of
Metashape.

    parsers.py TARGET [CORPUS] [libFuzzer's options]

For any bytes, a reader must return or raise MalusError.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["malus", "PIL", "laspy", "pye57"]):
    from malus import _files, campaign, exif, raw, scans, station_import
    from malus.errors import MalusError
    from malus.photogrammetry import metashape

FOLDER = Path(tempfile.mkdtemp(prefix="malus-fuzz-", dir="/dev/shm"))


def _written(name: str, data: bytes) -> Path:
    path = FOLDER / name
    path.write_bytes(data)
    return path


#: Target → reader.
TARGETS: dict[str, Callable[[bytes], object]] = {
    "exif": lambda data: exif.tags_of(_written("image", data)),
    "raw": lambda data: raw.linear_image(_written("image.dng", data), data),
    "las": lambda data: scans.read_scan(_written("cloud.las", data), "mm"),
    "e57": lambda data: scans.read_scan(_written("cloud.e57", data), "mm"),
    "table": lambda data: station_import._rows_of(_written("table.csv", data)),
    "sidecar": lambda data: (_written("image.json", data), station_import._shots_of_sidecars(FOLDER)),
    "metashape": lambda data: metashape.read_metashape(_written("cameras.xml", data)),
    "campaign": lambda data: campaign.Campaign.load(_written("campaign.toml", data)),
    "record": lambda data: _files.read_record(_written("record.json", data)),
}


def main() -> None:
    """Fuzz the target that the command line names."""
    read = TARGETS[sys.argv.pop(1)]

    def one_input(data: bytes) -> None:
        try:
            read(data)
        except MalusError:
            pass

    atheris.Setup(sys.argv, one_input)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
