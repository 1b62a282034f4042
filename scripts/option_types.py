"""Writes python/malus/_option_types.py, the options' types for editors and mypy, from the list in the library.

python scripts/option_types.py        (with malus installed; a test says when the file is out of date)
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from malus import _core

TARGET = Path(__file__).resolve().parents[1] / "python/malus/_option_types.py"

HEAD = '''"""Types of all options. Made by scripts/option_types.py from the list in the library; do not edit."""

from __future__ import annotations

from typing import Literal, TypedDict

from malus._section import Section
'''

TYPES = {
    "true or false": "bool",
    "a whole number": "int",
    "a number": "float",
    'a number or "auto"': 'float | Literal["auto"]',
}


def type_of(words: str) -> str:
    """Python's type for how the library calls it: `"on" | "off"` is a Literal."""
    return TYPES.get(words) or f"Literal[{words.replace(' | ', ', ')}]"


def section_text(name: str, fields: dict[str, dict[str, Any]]) -> str:
    """The section as attributes and as a mapping."""
    title = name.title()
    types = {key: type_of(field["type"]) for key, field in fields.items()}
    attributes = "\n".join(f'    {key}: {types[key]}\n    """{fields[key]["doc"]}"""' for key in fields)
    values = "\n".join(f"    {key}: {types[key]}" for key in fields)
    return (
        f'class {title}Section(Section):\n    """Options of the section {name}."""\n\n{attributes}\n\n\n'
        f'class {title}Values(TypedDict, total=False):\n    """The same as a mapping, any of them."""\n\n{values}\n'
    )


def text() -> str:
    """The whole file."""
    schema: dict[str, dict[str, dict[str, Any]]] = json.loads(_core.option_schema())
    sections = [section_text(name, fields) for name, fields in schema.items()]
    all_values = "\n".join(f"    {name}: {name.title()}Values" for name in schema)
    all_sections = "\n".join(f"    {name}: {name.title()}Section" for name in schema)
    sections.append(f'class Values(TypedDict, total=False):\n    """Options by section."""\n\n{all_values}\n')
    sections.append(f'class Sections:\n    """Attributes of `malus.Options`."""\n\n{all_sections}\n')
    return "\n\n".join([HEAD, *sections])


if __name__ == "__main__":
    TARGET.write_text(text(), encoding="utf-8")
