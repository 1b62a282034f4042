"""The paper whole: every figure and table of Mortazavi and SaadatSeresht from a finished workspace, for print.

`write_paper` leaves WORK/paper; `merge_campaign` makes one pair of tables of many workspaces. docs/paper.md lists what is
what.
"""

from __future__ import annotations

from malus.paper.writing import merge_campaign, write_paper

__all__ = ["merge_campaign", "write_paper"]
