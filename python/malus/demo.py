"""The example stations that ship with the project."""

from pathlib import Path

from malus.errors import InputError

#: Examples by name, with descriptions.
EXAMPLES = {
    "relief": "carved, textured stone in the sun",
    "bust": "head of one color in the sun",
    "coin": "black-lacquered coin under a softbox",
    "glass": "black glass with facets and engravings",
}


def example_station(name: str = "relief") -> Path:
    """Path of an example's station file, installed beside this module."""
    path = Path(__file__).parent / "examples" / name / "station.toml"
    if not path.exists():
        raise InputError(f"{path}: the example is missing from this installation of malus")
    return path
