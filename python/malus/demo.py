"""Where the example station is that ships with the project."""

from pathlib import Path

from malus.errors import InputError


def example_station() -> Path:
    """Path of the demo's station file, installed beside this module."""
    path = Path(__file__).parent / "examples" / "relief" / "station.toml"
    if not path.exists():
        raise InputError(f"{path}: the example is missing from this installation of malus")
    return path
