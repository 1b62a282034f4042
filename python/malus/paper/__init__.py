"""Every figure and table of the paper of Mortazavi and SaadatSeresht, made from a finished workspace, for print.

`write_paper` writes WORK/paper; `merge_campaign` merges the two tables of many workspaces. docs/paper.md lists the figures and tables.
"""

from __future__ import annotations

from malus.paper.writing import merge_campaign, write_paper

__all__ = ["merge_campaign", "write_paper"]
