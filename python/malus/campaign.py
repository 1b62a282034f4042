"""Campaign files: many stations with shared options, and the places of their results."""

from __future__ import annotations

import difflib
import glob
import hashlib
import json
import os
import re
import unicodedata
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from malus import _core
from malus._files import resolved, shortened
from malus._patterns import matching
from malus._toml import read_toml
from malus.errors import InputError, MalusError
from malus.options import Options
from malus.photogrammetry.photos import files_below
from malus.photogrammetry.shared_frame import content_of
from malus.station import Station

_KEYS = {"": ("campaign", "options"), "campaign": ("name", "stations", "report")}

_Value = TypeVar("_Value", str, bool, float)


@dataclass(frozen=True)
class Task:
    """One station of a campaign, with everything that a worker needs, on this machine or another that sees the same files."""

    identifier: str
    station: str
    output: str
    options: str
    threads: int
    report: bool
    cameras: str = ""
    """File with the station's cameras in a model that several stations share; empty = the station has cameras of its own."""
    photos_of: str = ""
    """File with the [photos] that several stations share; empty = the station's file has its own, or needs none."""

    def load(self) -> Station:
        """Read the station."""
        return Station.load(self.station, photos_of=self.photos_of or None)

    @property
    def workspace(self) -> Path:
        """Workspace folder of the station."""
        return Path(self.output) / "stations" / self.identifier

    @property
    def marker(self) -> Path:
        """File that says how the station ended; it is written last, and atomically."""
        return Path(self.output) / "done" / f"{self.identifier}.json"

    def key(self) -> str:
        """SHA-256 over version, options, and name, size and time of every file that the station names, also outside its folder.

        A marker with another key is not valid. (The workspace checks the content of inputs by itself, step by step.)
        """
        states = []
        for path in self._files():
            try:
                state = path.stat()
                states.append([str(path), state.st_size, state.st_mtime_ns])
            except OSError:
                states.append([str(path)])
        if self.cameras:
            states.append([content_of(Path(self.cameras))])
        return hashlib.sha256(
            json.dumps([_core.version, self.station, self.options, self.report, states]).encode()
        ).hexdigest()

    def _files(self) -> list[Path]:
        try:
            station = self.load().describe()
        except MalusError:
            return [Path(self.station)]
        files = [Path(path) for path in station["files"]]
        if "photos" in station:
            for folder in filter(None, (station["photos"]["folder"], station["photos"].get("masks"))):
                with suppress(InputError):  # too many files: the run itself raises the error
                    files += sorted(files_below(Path(folder)))
        return files


@dataclass(frozen=True)
class Campaign:
    """Stations, in the order of the file, and the options that all of them get. photos_of: absolute path of a file whose
    [photos] are those of all stations.
    """

    name: str
    stations: tuple[Path, ...]
    options: Options
    report: bool
    photos_of: Path | None = None

    @property
    def folder(self) -> Path:
        """The folder in which the folders of all stations are, to which tables and page name files."""
        return Path(os.path.commonpath([resolved(path.parent) for path in self.stations] or [Path("/")]))

    def station(self, path: str | Path) -> Station:
        """Read one of the stations."""
        return Station.load(path, photos_of=self.photos_of)

    @staticmethod
    def load(path: str | Path) -> Campaign:
        """Read a campaign file; InputError names file, field, value and what was expected.

        [campaign] has `stations`, a list of station files or globs relative to the file, and optionally `name` and
        `report` (false = no HTML report for each station). [options] has the content of a file for `--options`: fusion, and one
        table per step.
        """
        file = Path(path)
        content = read_tables(file, _KEYS)
        table = content.get("campaign")
        if not isinstance(table, dict):
            raise InputError(f"{file}: there is no table [campaign]")
        return Campaign(
            value_of(file, "campaign", table, "name", file.stem),
            stations_of(file, "campaign", table),
            options_of(file, content),
            value_of(file, "campaign", table, "report", True),
        )

    def tasks(self, output: str | Path, threads: int, cameras: Path | None = None) -> list[Task]:
        """One task per station, with distinct names: the name of the station file's folder, and the file's own name unless it is
        station.toml. Names that differ in capital letters alone do not count as distinct: on many network disks and memory cards they are
        one folder.

        cameras: folder with the cameras of each station in NAME.json, if the stations share one model.
        """
        names = [
            path.parent.name if path.stem == "station" else f"{path.parent.name}-{path.stem}" for path in self.stations
        ]
        identifiers: list[str] = []
        like: Counter[str] = Counter()  # by name: identifiers that are this name, or this name with a number
        for name in (shortened(re.sub(r"[^\w.-]+", "-", name).strip(".-") or "station") for name in names):
            count = like[name.casefold()]
            identifier = name if count == 0 else f"{name}-{count + 1}"
            identifiers.append(identifier)
            folded = identifier.casefold()
            numbered = re.fullmatch(r"(.+)-\d+", folded)
            like.update([folded] if numbered is None else [folded, numbered[1]])
        if len({identifier.casefold() for identifier in identifiers}) < len(identifiers):
            raise InputError(
                f"campaign {self.name}: station folders {', '.join(names)} cannot be told apart by their names"
            )
        folder = str(resolved(output))
        return [
            Task(
                identifier,
                str(path),
                folder,
                self.options.to_json(),
                threads,
                self.report,
                "" if cameras is None else str(resolved(cameras) / f"{identifier}.json"),
                "" if self.photos_of is None else str(self.photos_of),
            )
            for identifier, path in zip(identifiers, self.stations, strict=True)
        ]


#: Kinds of TOML files: what messages call them, and the command that runs them.
_KINDS = {"station": ("a station file", "run"), "object": ("an object file", "object"), "campaign": ("a campaign file", "batch")}  # fmt: skip


def require_kind(file: Path, expected: str, content: Mapping[str, Any] | None = None) -> None:
    """Raise InputError, which names the right command, if a TOML file is clearly of another kind: station, object or campaign.

    content: of the file, if it has been read. A file that cannot be read passes: its reader raises the error.
    """
    _require_no_folder(file, expected)
    found = kinds_of(file, content)
    if found and expected not in found:
        name, command = _KINDS[found[0]]
        raise InputError(f"{file}: is {name}, expected {_KINDS[expected][0]}; `malus {command} {file} -o DIR` runs it")


def _require_no_folder(file: Path, expected: str) -> None:
    """InputError if a folder is given in place of the file in it."""
    usual = file / f"{expected}.toml"
    if usual.is_file():
        raise InputError(f"{file}: is a folder, expected {_KINDS[expected][0]}, such as {usual}")


def kinds_of(file: Path, content: Mapping[str, Any] | None = None) -> list[str]:
    """The kinds of file (station, object, campaign) that a TOML file may be, by its tables; none if it cannot be read."""
    if content is None:
        try:
            content = read_toml(file, "file")
        except MalusError:
            return []
    thing = content.get("object")
    kinds = {
        "campaign": "campaign" in content,
        # A station file may have a table [object], too: the catalog entries.
        "object": isinstance(thing, dict) and "stations" in thing,
        "station": "polarized" in content,
    }
    return [kind for kind, is_it in kinds.items() if is_it]


def read_tables(file: Path, keys: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    """Content of a TOML file; InputError for unknown tables and keys. `keys`: the known keys of each table; "" stands for the top
    level, whose keys are the tables.
    """
    kind = "campaign" if "campaign" in keys else "object"
    _require_no_folder(file, kind)
    content = read_toml(file, f"{kind} file")
    require_kind(file, kind, content)
    _check_keys(file, content, "", keys[""])
    for name, table in content.items():
        if name in keys and isinstance(table, dict):
            _check_keys(file, table, name, keys[name])
    return content


def value_of(file: Path, name: str, table: Mapping[str, Any], key: str, default: _Value) -> _Value:
    """The value of a key, or the default if it is missing; InputError unless it has the default's type."""
    value = table.get(key, default)
    if isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if not isinstance(value, type(default)):
        expected = {str: "a string", bool: "true or false", float: "a number"}[type(default)]
        raise InputError(f"{file}: {name}.{key} = {value!r}, expected {expected}")
    if isinstance(value, str) and any(unicodedata.category(sign) == "Cc" for sign in value):
        raise InputError(f"{file}: {name}.{key} = {value!r}, expected one line without control characters")
    return value


def options_of(file: Path, content: Mapping[str, Any]) -> Options:
    """The options that all stations get, from the table [options]."""
    options = Options()
    changes = content.get("options", {})
    if not isinstance(changes, dict):
        raise InputError(f"{file}: options = {changes!r}, expected a table")
    try:
        options.update(changes)
    except InputError as error:
        raise InputError(f"{file}: [options]: {error}") from None
    return options


def stations_of(file: Path, name: str, table: Mapping[str, Any]) -> tuple[Path, ...]:
    """The station files in the key `stations` of a table: paths or globs relative to the file; no glob matches the file itself."""
    patterns = table.get("stations")
    if not isinstance(patterns, list) or not patterns or not all(isinstance(entry, str) for entry in patterns):
        said = f"= {patterns!r}" if "stations" in table else "is missing"
        raise InputError(f"{file}: {name}.stations {said}, expected a list of station files or globs")
    found: dict[Path, None] = {}
    for pattern in patterns:
        # A file's own name is no pattern, even with brackets: "Bust [copy]/station.toml".
        if glob.has_magic(pattern) and not os.path.exists(file.parent / pattern):
            found_by = matching(file.parent, pattern, f"{file}: {name}.stations")
            matches = sorted(match for match in found_by if resolved(match) != resolved(file))
            if not matches:
                raise InputError(f"{file}: {name}.stations: no file matches {pattern!r}")
        else:
            matches = [file.parent / pattern]
        found.update(dict.fromkeys(resolved(match) for match in matches))
    return tuple(found)


def _check_keys(file: Path, table: Mapping[str, Any], name: str, known: Sequence[str]) -> None:
    for key in table:
        if key in known:
            continue
        where = f"{name}.{key}" if name else f"[{key}]"
        near = difflib.get_close_matches(key, known, n=1)
        hint = f"; did you mean {near[0]}?" if near else f", expected {', '.join(known)}"
        raise InputError(f"{file}: unknown key {where}{hint}")
