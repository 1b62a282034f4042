"""Edits the station file and its options for Studio; everything that is not changed keeps its text, including comments."""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import AoT, Table, Whitespace

from malus._files import read_regular, reading, write_bytes
from malus.errors import InputError

#: Tables that may occur any number of times in a station file.
LISTS = ("scale", "control", "patch", "profile")
#: Tables that occur once; all other names from the page are refused.
TABLES = ("station", "object", "polarized", "optics", "camera", "prior", "photos")


class ChangedError(InputError):
    """A file has changed since the page read it; nothing was written."""

    def __init__(self, path: Path) -> None:
        super().__init__(f"{path}: was changed by another program or page since Studio read it")


class TomlDocument:
    """A TOML file to be changed."""

    def __init__(self, path: Path, text: str) -> None:
        self.path = path
        try:
            # First by the standard library: tomlkit reads files in which a table stands twice, and fails when they are changed.
            tomllib.loads(text)
            self._document = tomlkit.parse(text)
        except (ValueError, TOMLKitError, RecursionError) as error:
            raise InputError(f"{path}: not valid TOML ({error})") from None

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a file; InputError unless it is TOML in UTF-8."""
        with reading(path):
            content = read_regular(path)
        try:
            return cls(path, content.decode("utf-8-sig"))
        except UnicodeDecodeError:
            raise InputError(f"{path}: is not UTF-8 text, expected a TOML file") from None

    @property
    def text(self) -> str:
        """The text that would be written now."""
        return tomlkit.dumps(self._document)

    def set(self, table: str, key: str, value: Any) -> None:
        """Set a value, or remove it with None. The text of an equal value is not changed."""
        if table not in self._document:
            if value is None:
                return
            self._document[table] = tomlkit.table()
        content = self._document[table]
        if not isinstance(content, Table):
            raise InputError(f"{self.path}: {table} is no table, expected [{table}]")
        _assign(content, key, value)
        if not content:
            del self._document[table]


class StationDocument(TomlDocument):
    """A station file, read, changed and written back."""

    def __init__(self, path: Path, text: str) -> None:
        super().__init__(path, text)
        self.digest = digest_of(text)

    @property
    def values(self) -> dict[str, Any]:
        """All values of the file, as plain data."""
        values: dict[str, Any] = self._document.unwrap()
        return values

    def set(self, table: str, key: str, value: Any) -> None:
        """As `TomlDocument.set`, for the tables of a station file only."""
        if table not in TABLES:
            raise InputError(f"[{table}] is no table of a station file, expected one of {', '.join(TABLES)}")
        super().set(table, key, value)

    def set_list(self, name: str, entries: Sequence[Mapping[str, Any]]) -> None:
        """Replace the tables [[name]] by `entries`; tables that stay in place keep their comments."""
        if name not in LISTS:
            raise InputError(f"[[{name}]] is no list of a station file, expected one of {', '.join(LISTS)}")
        if not entries:
            self._document.pop(name, None)
            return
        if name not in self._document:
            self._document[name] = tomlkit.aot()
        present = self._document[name]
        if not isinstance(present, AoT):
            raise InputError(f"{self.path}: {name} is no list of tables, expected [[{name}]]")
        for index, entry in enumerate(entries):
            if index == len(present):
                present.append(tomlkit.table())
            table = present[index]
            for key in [*(key for key in table if key not in entry), *entry]:
                _assign(table, key, entry.get(key))
        while len(present) > len(entries):
            del present[len(present) - 1]

    def require(self, expected: str | None) -> None:
        """Raise ChangedError unless the file has the digest `expected`. None = no file must exist, else InputError."""
        # Bytes: text mode would change the line ends of Windows.
        current = digest_of(read_regular(self.path).decode("utf-8-sig", "replace")) if self.path.exists() else None
        if current == expected:
            return
        if expected is None:
            raise InputError(f"{self.path}: exists already, expected another name")
        raise ChangedError(self.path)

    def write(self, expected: str | None) -> None:
        """Write the file if `require` finds it unchanged."""
        self.require(expected)
        write_bytes(self.path, self.text.encode())
        self.digest = digest_of(self.text)


def digest_of(text: str) -> str:
    """SHA-256 of the text of a file, to detect changes."""
    return hashlib.sha256(text.encode()).hexdigest()


def _assign(table: Table, key: str, value: Any) -> None:
    if value is None:
        table.pop(key, None)
        return
    if key in table and table.unwrap()[key] == value:
        return
    item = tomlkit.item(value)
    if isinstance(value, list) and value and isinstance(value[0], Mapping):
        # Marks are written as inline tables, one per line.
        item = tomlkit.array()
        for entry in value:
            inline = tomlkit.inline_table()
            inline.update(entry)
            item.append(inline)
        item.multiline(True)
    # What stands behind a blank line at the table's end, such as the comment on the next table, stays at its end.
    body = table.value.body
    end = next((at for at in range(len(body), 0, -1) if body[at - 1][0] is not None), 0)
    blank = next((at for at in range(end, len(body)) if isinstance(body[at][1], Whitespace)), len(body))
    behind = [] if key in table else body[blank:]
    del body[len(body) - len(behind) :]
    table[key] = item
    body.extend(behind)
