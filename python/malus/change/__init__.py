"""Changes of an object between two dates: two finished workspaces are registered and compared, with the significance of each change.

`registration` registers the later surface to the earlier one by the parts that did not change. `significance` measures signed distances
and the smallest detectable change. `regions` finds connected significant parts, and `page` shows them.
"""

from malus.change.run import Change, change_summary, compare

__all__ = ["Change", "change_summary", "compare"]
