"""An orange: dimples, a texture."""

from .round_objects import STYLES, scene_of

scene = scene_of("orange")

__all__ = ["STYLES", "scene"]
