"""The report's figures, each drawn from a finished workspace, with the numbers behind it."""

from malus.figures.figure import Figure
from malus.figures.plates import Plates

__all__ = ["Figure", "Plates"]
