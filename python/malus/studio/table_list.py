"""Replaces the tables of a list in a station file, such as [[patch]]; tables that stay keep the comments around them."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import tomlkit
from tomlkit import TOMLDocument
from tomlkit.items import AoT, Key, SingleKey, Table, Whitespace

from malus.studio.toml_body import Body, assign, behind, last_body, text_of

_Values = Mapping[str, Any]


@dataclass
class _Part:
    """A table of the list, without the text behind its last key, and the comments around it."""

    table: Table
    above: str
    """Comment right above its header."""
    below: str
    """Comment right below its last key."""
    between: str
    """The text between these comments, from the first to the last blank line, which belongs to neither table."""


@dataclass
class _List:
    """A file that is taken apart at a list."""

    key: Key
    front: str
    parts: list[_Part]
    back: str
    """What stands behind the last table and its comment."""


def text_with_list(document: TOMLDocument, name: str, entries: Sequence[_Values]) -> str:
    """The text of a file in which the tables [[name]] are `entries`; `document` cannot be used afterwards.

    Comments right above and below a table stay with it, also where tables before it are removed, and are removed with it.
    """
    # tomlkit fails to unwrap some files with parts of a table apart.
    sources = _sources(tomllib.loads(document.as_string()).get(name, []), entries)
    found = _taken_apart(document, name)
    for at in sorted(set(range(len(found.parts))).difference(sources), reverse=True):
        _give_up(found, at)
    text, pending = found.front, ""
    for entry, source in zip(entries, sources, strict=True):
        text = _joined(text, pending)
        if source is None:
            text, part = _with_blank_line(text), _Part(tomlkit.table(), "", "", "\n")
        else:
            text, part = _with_line_end(text), found.parts[source]
        for key in [*(key for key in part.table if key not in entry), *entry]:
            assign(part.table, key, entry.get(key))
        text += part.above + _text(found.key, part.table) + part.below
        pending = part.between
    return _joined(_joined(text, pending) if found.back or "#" in pending else text, found.back)


def _taken_apart(document: TOMLDocument, name: str) -> _List:
    body = document.body
    place = next((at for at, (key, _) in enumerate(body) if key is not None and key.key == name), None)
    if place is None:
        return _List(SingleKey(name), document.as_string(), [], "")
    key, present = body[place]
    assert key is not None and isinstance(present, AoT)
    before = body[place - 1][1] if place > 0 else None
    gap = text_of(last_body(before) if isinstance(before, Table | AoT) else body[:place])
    # Where the list stood: TOML has no such character. Before a table tomlkit adds the end of the line if it is missing.
    mark = "\0\n"
    body[place] = (None, Whitespace(mark))
    front, back = document.as_string().split(mark)
    above = _parted(gap)[2]
    front = front.removesuffix(above)
    parts = []
    for table in present.body:
        behind_table = _cut(last_body(table))
        below, between, of_next = _parted(behind_table)
        parts.append(_Part(table, above, below, between))
        above = of_next
    if not back and not parts[-1].between:
        # Nothing follows whose comment it could be.
        parts[-1].below, above = behind_table, ""
    back = parts[-1].between + above + back
    parts[-1].between = ""
    return _List(key, front, parts, back)


def _cut(body: Body) -> str:
    """Remove the text behind the last key; returns it."""
    text = text_of(body)
    del body[behind(body) :]
    return text


def _parted(gap: str) -> tuple[str, str, str]:
    """The text between two tables: comment of the first one, what belongs to neither, comment of the second one. Without a blank line all
    of it belongs to the second one.
    """
    lines = re.findall(r"[^\n]*\n|[^\n]+", gap)
    blank = [at for at, line in enumerate(lines) if not line.strip()]
    if not blank:
        return "", "", gap
    first, end = blank[0], blank[-1] + 1
    return "".join(lines[:first]), "".join(lines[first:end]), "".join(lines[end:])


def _sources(present: Sequence[_Values], entries: Sequence[_Values]) -> list[int | None]:
    """For each entry the table that it is made of, None = a new one: the same table, or the one that it is after a change."""
    found: list[int | None] = [None] * len(entries)
    free = list(range(len(present)))
    alike: tuple[Callable[[_Values, _Values], bool], ...] = (
        lambda table, entry: table == entry,
        lambda table, entry: "name" in entry and table.get("name") == entry["name"],
        lambda table, entry: any(table.get(key) == value for key, value in entry.items()),
        lambda table, entry: True,
    )
    for are_alike in alike:
        for at, entry in enumerate(entries):
            if found[at] is None:
                source = next((place for place in free if are_alike(present[place], entry)), None)
                if source is not None:
                    free.remove(source)
                    found[at] = source
    return found


def _give_up(found: _List, at: int) -> None:
    """Leave a table out. Comments between it and the next one stay."""
    between = found.parts[at].between
    if "#" not in between:
        return
    if at == 0:
        found.front = _joined(found.front, between)
    else:
        found.parts[at - 1].between = _joined(found.parts[at - 1].between, between)


def _text(key: Key, table: Table) -> str:
    """The text of a table of the list."""
    alone = tomlkit.document()
    alone.body.append((key, AoT([table], parsed=True)))
    return alone.as_string()


def _joined(text: str, more: str) -> str:
    """Both texts; blank lines do not add up."""
    return text + (more.lstrip("\r\n") if not text or _ends_blank(text) else more)


def _ends_blank(text: str) -> bool:
    return re.search(r"(?:\A|\n)[ \t]*\r?\n\Z", text) is not None


def _with_line_end(text: str) -> str:
    return text if not text or text.endswith("\n") else text + "\n"


def _with_blank_line(text: str) -> str:
    return text if not text or _ends_blank(text) else _with_line_end(text) + "\n"
