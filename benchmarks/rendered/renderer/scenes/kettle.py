"""A kettle of rough metal."""

from .round_objects import STYLES, scene_of

scene = scene_of("kettle")

__all__ = ["STYLES", "scene"]
