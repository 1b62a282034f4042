"""The example stations that ship with the project."""

from pathlib import Path

from malus.errors import InputError

#: Names of the examples.
EXAMPLES = ("relief", "bust", "coin", "glass")


def example_station(name: str = "relief") -> Path:
    """Path of an example's station file, installed beside this module."""
    path = Path(__file__).parent / "examples" / name / "station.toml"
    if not path.exists():
        raise InputError(f"{path}: the example is missing from this installation of malus")
    return path
