"""Edits the station file and its options for Studio; everything that is not changed keeps its text, including comments."""

from __future__ import annotations

import hashlib
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import AoT, InlineTable, Item, Key, Table, Whitespace

from malus._files import read_regular, reading, write_bytes
from malus.errors import InputError
from malus.studio.table_list import text_with_list
from malus.studio.toml_body import assign, last_body, text_of

#: Tables that may occur any number of times in a station file.
LISTS = ("scale", "control", "patch", "profile")
#: Tables that occur once; all other names from the page are refused.
TABLES = ("station", "object", "polarized", "optics", "camera", "prior", "photos")
#: The sign of a comment, or a whole string: of the two, the one that begins first counts.
_COMMENT_OR_STRING = re.compile(r"""#|"{3}(?:\\.|[^\\])*?"{3}|'{3}.*?'{3}|"(?:\\.|[^"\\])*"|'[^']*'""", re.DOTALL)


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
            self._take(text)
        except (ValueError, TOMLKitError, RecursionError) as error:
            raise InputError(f"{path}: not valid TOML ({error})") from None

    def _take(self, text: str) -> None:
        self._document = tomlkit.parse(text)
        #: The text, if tomlkit would move parts of it: it gathers the tables of a list that have other tables between them.
        self._as_written = None if tomlkit.dumps(self._document) == text else text

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
        return self._as_written or tomlkit.dumps(self._document)

    def set(self, table: str, key: str, value: Any) -> None:
        """Set a value, or remove it with None. The text of an equal value is not changed."""
        with self._changing(table):
            if table not in self._document:
                if value is None:
                    return
                self._document[table] = tomlkit.table()
            place = self._place_of(table, key)
            part = self._document.body[place][1]
            if not isinstance(part, Table | InlineTable):
                raise InputError(f"{self.path}: {table} is no table, expected [{table}]")
            assign(part, key, value)
            if not part:
                self._remove(place)

    @contextmanager
    def _changing(self, name: str) -> Iterator[None]:
        """Raise InputError, and change nothing, where tomlkit fails to change a table or list, makes a text that is not TOML, or would
        move comments to other tables. Where no value changes, nothing is moved.
        """
        before, is_moved = self.text, self._as_written is not None
        self._as_written = None
        try:
            yield
            is_same = tomllib.loads(self.text) == tomllib.loads(before)
            if is_moved and not is_same and _has_comments(before):
                raise InputError(
                    f"{self.path}: Studio cannot change {name} as it is written there, without moving comments: tables of a list have "
                    "other tables between them, expected those of each list, such as [[patch]], one after the other"
                )
        except InputError:
            self._take(before)
            raise
        except (ValueError, KeyError, TOMLKitError, RecursionError):
            self._take(before)
            where = f"[[{name}]]" if name in LISTS else f"[{name}]"
            raise InputError(
                f"{self.path}: Studio cannot change {name} as it is written there, expected {where} with its keys on the lines below"
            ) from None
        if is_moved and is_same:
            self._take(before)

    def _place_of(self, table: str, key: str) -> int:
        """Where in the file's body the part of a table is that has the key, or should have it.

        A table may have several parts: [photos] and, apart, [photos.camera], or keys such as station.name.
        """
        places = self._places(table)
        body = self._document.body
        for place in places:
            part = body[place][1]
            if isinstance(part, Table | InlineTable) and key in part:
                return place
        return next((place for place in places if not _is_prefix(*body[place])), places[-1])

    def _places(self, name: str) -> list[int]:
        """Where in the file's body the parts of a table or list stand."""
        return [place for place, (key, _) in enumerate(self._document.body) if key is not None and key.key == name]

    def _remove(self, place: int) -> None:
        """Remove a table, except what stands behind its last key, such as the comment on the next table."""
        item = self._document.body[place][1]
        left = text_of(last_body(item)) if isinstance(item, Table) else ""
        self._document.body[place] = (None, Whitespace(left.lstrip("\r\n")))
        # tomlkit's index of the body still has the table.
        self._document = tomlkit.parse(self.text)


class StationDocument(TomlDocument):
    """A station file, read, changed and written back."""

    def __init__(self, path: Path, text: str) -> None:
        super().__init__(path, text)
        self.digest = digest_of(text)

    @property
    def values(self) -> dict[str, Any]:
        """All values of the file, as plain data."""
        # tomlkit fails to unwrap some files with parts of a table apart.
        return tomllib.loads(self.text)

    def set(self, table: str, key: str, value: Any) -> None:
        """As `TomlDocument.set`, for the tables of a station file only."""
        if table not in TABLES:
            raise InputError(f"[{table}] is no table of a station file, expected one of {', '.join(TABLES)}")
        super().set(table, key, value)

    def set_list(self, name: str, entries: Sequence[Mapping[str, Any]]) -> None:
        """Replace the tables [[name]] by `entries`; tables that stay keep their comments."""
        if name not in LISTS:
            raise InputError(f"[[{name}]] is no list of a station file, expected one of {', '.join(LISTS)}")
        with self._changing(name):
            self._replace(name, entries)

    def _replace(self, name: str, entries: Sequence[Mapping[str, Any]]) -> None:
        if name in self._document and not isinstance(self._document[name], AoT):
            raise InputError(f"{self.path}: {name} is no list of tables, expected [[{name}]]")
        self._document = tomlkit.parse(text_with_list(self._document, name, entries))

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


def _has_comments(text: str) -> bool:
    """Whether a TOML text has comments, and not only # in its strings."""
    return any(part[0] == "#" for part in _COMMENT_OR_STRING.finditer(text))


def digest_of(text: str) -> str:
    """SHA-256 of the text of a file, to detect changes."""
    return hashlib.sha256(text.encode()).hexdigest()


def _is_prefix(key: Key | None, part: Item) -> bool:
    """Whether a part of a table has neither a header nor dotted keys, as that of [photos.camera] in [photos]."""
    return isinstance(part, Table) and part.is_super_table() and not (key and key.is_dotted())
