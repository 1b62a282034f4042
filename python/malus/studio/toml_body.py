"""The bodies of tables and files as tomlkit has them: blank lines and comments behind the last key, and values that are set."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import tomlkit
from tomlkit.items import AoT, InlineTable, Item, Key, Null, Table, Whitespace

#: Values with their keys, and blank lines and comments without.
Body = list[tuple[Key | None, Item]]


def _first_header(item: Item) -> Item:
    """The table whose header is written first for a table or list."""
    if isinstance(item, AoT):
        return item[0]
    if not (isinstance(item, Table) and item.is_super_table()):
        return item
    inner = (within for _, within in item.value.body if isinstance(within, Table | AoT))
    return next(map(_first_header, inner), item)


def last_body(item: Table | AoT) -> Body:
    """The body of the table that stands last in a table or list."""
    table = item[len(item) - 1] if isinstance(item, AoT) else item
    body: Body = table.value.body
    return last_body(body[-1][1]) if body and isinstance(body[-1][1], Table | AoT) else body


def behind(body: Body) -> int:
    """Where the blank lines and comments behind the last key begin, also if the key was removed."""
    last = (at for at in range(len(body), 0, -1) if body[at - 1][0] is not None or isinstance(body[at - 1][1], Null))
    return next(last, 0)


def text_of(body: Body) -> str:
    """The text behind the last key."""
    return "".join(item.as_string() for _, item in body[behind(body) :])


def _cut_behind(body: Body) -> str:
    """Remove the first blank line behind the last key and what follows, such as the comment on the next table; returns its text.

    Without a blank line all of it belongs to the next table.
    """
    last = behind(body)
    begin = next((at for at in range(last, len(body)) if isinstance(body[at][1], Whitespace)), last)
    text = "".join(item.as_string() for _, item in body[begin:])
    del body[begin:]
    return text


def _add(table: Table, key: str, item: Item) -> None:
    """Add a key. The comment on the next table stays before that."""
    body = table.value.body
    inner = next(
        (
            at
            for at, (k, v) in enumerate(body)
            if isinstance(v, AoT) or (k and isinstance(v, Table) and not k.is_dotted())
        ),
        None,
    )
    if inner is None:
        left = _cut_behind(body)
        table[key] = item
        body.append((None, Whitespace(left)))
        return
    own = body[:inner]
    left = _cut_behind(own)
    # The places of the tables behind stay: tomlkit has an index of them.
    body[len(own) : inner] = [(None, Null())] * (inner - len(own))
    header = _first_header(body[inner][1])
    header.trivia.indent = left + header.trivia.indent
    table[key] = item


def assign(table: Table | InlineTable, key: str, value: Any) -> None:
    """Set a value of a table, or remove it with None. The text of an equal value is not changed."""
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
    if key in table or isinstance(table, InlineTable):
        table[key] = item
    else:
        _add(table, key, item)
