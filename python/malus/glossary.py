"""The terms of docs/glossary.md, for the report."""

import re
from functools import cache
from importlib import resources


@cache
def definitions() -> dict[str, str]:
    """Term → its definition, one or more sentences."""
    text = resources.files("malus").joinpath("assets/glossary.md").read_text(encoding="utf-8")
    entries = re.findall(r"^- \*\*(.+?)\*\*: (.+?)(?=^- |^$|\Z)", text, re.MULTILINE | re.DOTALL)
    return {term: " ".join(definition.split()) for term, definition in entries}
