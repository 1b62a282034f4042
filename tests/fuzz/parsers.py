"""Fuzzes Python's readers of users' files with atheris: EXIF, RAW, LAS, E57, tables and notes beside images, cameras of
Metashape, object files, and what Studio's page sends.

    parsers.py TARGET[,TARGET…] [CORPUS] [libFuzzer's options]

For any bytes, a reader must return or raise MalusError. In CORPUS and options, {} stands for the target. Several targets are fuzzed one
after the other, each in a process forked from this one: to import and instrument everything takes as long as a short attack.
"""

from __future__ import annotations

import json
import os
import re
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import atheris

with atheris.instrument_imports(include=["malus", "PIL", "laspy", "pye57", "tomlkit"]):
    from malus import _files, _laz, campaign, exif, raw, scans, station_import
    from malus.errors import MalusError
    from malus.object import Object
    from malus.photogrammetry import metashape
    from malus.studio import masks
    from malus.studio.document import StationDocument

sys.path.append(str(Path(__file__).resolve().parents[1] / "python"))
from laz_decoder import Decoder
from stations import write_inputs

from e57_pages import as_file

FOLDER = Path(tempfile.mkdtemp(prefix="malus-fuzz-", dir="/dev/shm"))


def _written(name: str, data: bytes) -> Path:
    path = FOLDER / name
    path.write_bytes(data)
    return path


def _in_folder(data: bytes) -> bytes:
    """A campaign or object whose patterns stay in its folder: others search the disk, up to 100 000 names (test_limits.py)."""
    return re.sub(rb"(?<=[\"'])[\s/~]+|\.\.", b"", data)


def _uncompressed(data: bytes) -> bytes:
    """A LAS file without the mark of compressed points, for which each reading starts a process."""
    at = 104
    return data[:at] + bytes([data[at] & 0x3F]) + data[at + 1 :] if len(data) > at else data


def _edited(document: StationDocument) -> str:
    """A station file as Studio's page changes it: what was set is in its text, and all else is as before."""
    expected = document.values

    def change(table: str, key: str, value: object) -> None:
        document.set(table, key, value)
        content = {**expected.get(table, {}), key: value}
        expected[table] = {name: entry for name, entry in content.items() if entry is not None}

    def change_list(name: str, entries: list[dict[str, object]]) -> None:
        document.set_list(name, entries)
        expected[name] = entries

    change("camera", "params", [1.0, 2.0])
    change_list("scale", [{"distance": 2.0}, {"check": True}])
    change_list("scale", [{"distance": 2.0}])
    change("photos", "folder", "photos")
    for table in ("camera", "photos"):
        change(table, "params", None)
    change_list("scale", [])
    kept = {name: entry for name, entry in expected.items() if entry or name not in ("camera", "photos", "scale")}
    found = StationDocument(document.path, document.text).values
    assert _sorted(found) == _sorted(kept), f"{_sorted(found)}, expected {_sorted(kept)}"
    return document.text


def _sorted(values: dict[str, Any]) -> str:
    return json.dumps(values, sort_keys=True, default=repr)


#: Target → reader.
TARGETS: dict[str, Callable[[bytes], object]] = {
    "exif": lambda data: exif.tags_of(_written("image", data)),
    "raw": lambda data: raw.linear_image(_written("image.dng", data), data),
    "las": lambda data: scans.read_scan(_written("cloud.las", _uncompressed(data)), "mm"),
    "laz": lambda data: scans.read_scan(_written("cloud.laz", data), "mm"),
    # The input is the file without its checksums, which no fuzzer could keep right.
    "e57": lambda data: scans.read_scan(_written("cloud.e57", as_file(data)), "mm"),
    "table": lambda data: station_import._rows_of(_written("table.csv", data)),
    "sidecar": lambda data: station_import._shots_of_sidecars(
        _written("image.json", data).parent, [FOLDER / "image.png"]
    ),
    "metashape": lambda data: metashape.read_metashape(_written("cameras.xml", data)),
    "object": lambda data: Object.load(_written("object.toml", _in_folder(data))),
    "document": lambda data: _edited(StationDocument.read(_written("edited.toml", data))),
    "painted": lambda data: masks.decode(data, (8, 6)),
    "campaign": lambda data: campaign.Campaign.load(_written("campaign.toml", _in_folder(data))),
    "record": lambda data: _files.read_record(_written("record.json", data)),
}


def main() -> None:
    """Fuzz the targets that the command line names."""
    program, names, *words = sys.argv
    write_inputs(FOLDER)
    targets = names.split(",")
    if len(targets) == 1:
        fuzz(targets[0], [program, *words])
        return
    codes = []
    for target in targets:
        print(f"{target}:", flush=True)
        child = os.fork()
        if child == 0:
            fuzz(target, [program, *words])
        codes.append(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
    sys.exit(int(any(codes)))


def fuzz(target: str, words: list[str]) -> None:
    """Fuzz a target; libFuzzer ends the process."""
    read = TARGETS[target]
    if target == "laz":
        _laz.subprocess = SimpleNamespace(run=Decoder())

    def one_input(data: bytes) -> None:
        try:
            read(data)
        except MalusError:
            pass

    atheris.Setup([word.replace("{}", target) for word in words], one_input)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
