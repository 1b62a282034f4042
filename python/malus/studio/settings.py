"""Options of the runs of a station: a TOML file beside the station file, which `malus run --options` reads too."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import Table

from malus._files import write_bytes
from malus._toml import read_toml
from malus.errors import InputError
from malus.options import MAIN, Options


def file_of(station: Path) -> Path:
    """The file that holds the options of a station's runs; it need not be there."""
    return station.with_name(f"{station.stem}_options.toml")


def options_of(station: Path) -> Options:
    """The options of a station's runs; InputError for a file that says something else."""
    options = Options()
    path = file_of(station)
    if path.is_file():
        options.update_from_file(path)
    return options


def listed(station: Path) -> list[dict[str, Any]]:
    """The options that matter most, and every other one that the file sets: name, title, what it may be, default, meaning and value."""
    values = options_of(station).to_dict()
    path = file_of(station)
    stated = read_toml(path) if path.is_file() else {}
    rows = []
    for name, kind, default, meaning in Options.describe():
        section, key = name.split(".")
        if name in MAIN or key in stated.get(section, {}):
            rows.append({"name": name, "title": MAIN.get(name, name), "kind": kind, "default": default, "meaning": meaning, "value": values[section][key]})  # fmt: skip
    return rows


def change(station: Path, name: str, value: Any) -> None:
    """Set an option, or with None leave it to its default; what the file says besides, and its comments, stay.

    Raises InputError, and writes nothing, for an option or a value that there is not.
    """
    section, _, key = name.partition(".")
    if value is not None:
        Options().update({section: {key: value}})
    path = file_of(station)
    try:
        document = tomlkit.parse(path.read_text(encoding="utf-8-sig") if path.is_file() else "")
    except (TOMLKitError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not valid TOML ({error})") from None
    table = document.setdefault(section, tomlkit.table())
    if not isinstance(table, Table):
        raise InputError(f"{path}: {section} is no table, expected [{section}]")
    if value is None:
        table.pop(key, None)
    else:
        table[key] = value
    if not table:
        del document[section]
    if document or path.is_file():
        write_bytes(path, tomlkit.dumps(document).encode())
