"""What changed on an object between two dates: two finished workspaces, registered and compared with stated significance.

`registration` lays the later surface upon the earlier one by the parts that did not change, `significance` measures signed distances and
the smallest that could be told, `regions` gathers what is significant, `page` shows it.
"""

from malus.change.run import Change, change_summary, compare

__all__ = ["Change", "change_summary", "compare"]
