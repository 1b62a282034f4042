"""Options of a station's runs: a TOML file beside the station file, which `malus run --options` also reads."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from malus._files import write_bytes
from malus._toml import read_toml
from malus.options import MAIN, Options, allowed
from malus.studio.document import TomlDocument


def file_of(station: Path) -> Path:
    """The file for the options of a station's runs; it need not exist."""
    return station.with_name(f"{station.stem}_options.toml")


def options_of(station: Path) -> Options:
    """The options of a station's runs; InputError if the file holds anything else."""
    options = Options()
    path = file_of(station)
    if path.is_file():
        options.update_from_file(path)
    return options


def listed(station: Path) -> list[dict[str, Any]]:
    """The main options, and all other options that the file sets: name, title, kind of value, allowed values in words, default, meaning
    and value.
    """
    values = options_of(station).to_dict()
    path = file_of(station)
    stated = read_toml(path, "options file") if path.is_file() else {}
    rows = []
    for name, kind, default, meaning in Options.describe():
        section, key = name.split(".")
        if name in MAIN or key in stated.get(section, {}):
            rows.append({"name": name, "title": MAIN.get(name, name), "kind": kind, "allowed": allowed(name), "default": default, "meaning": meaning, "value": values[section][key]})  # fmt: skip
    return rows


def change(station: Path, name: str, value: Any) -> None:
    """Set an option, or with None return it to its default. All other options and comments in the file are kept; a file of which
    nothing is left is removed, since an empty one is an error.

    For an option or value that does not exist, raises InputError and writes nothing.
    """
    section, _, key = name.partition(".")
    if value is not None:
        Options().update({section: {key: value}})
    path = file_of(station)
    document = TomlDocument.read(path) if path.is_file() else TomlDocument(path, "")
    document.set(section, key, value)
    if document.text.strip():
        write_bytes(path, document.text.encode())
    else:
        path.unlink(missing_ok=True)
