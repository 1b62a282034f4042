"""A ribbed vase with black and white paint."""

from .round_objects import STYLES, scene_of

scene = scene_of("vase")

__all__ = ["STYLES", "scene"]
