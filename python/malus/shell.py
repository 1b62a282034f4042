"""Shell completion of commands, options and files, and a manual page, both generated from the command line's parsers."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

from malus._extra import extra

SHELLS = ("bash", "zsh")


def completion(parser: argparse.ArgumentParser, shell: str) -> str:
    """Script that completes the program's command line in one of SHELLS; ExternalError without shtab."""
    shtab = extra("shtab", "shtab", "malus completion", "shell")
    for one in _parsers(parser):
        for action in one._actions:
            if action.type is Path:
                action.complete = shtab.FILE  # type: ignore[attr-defined]
    return str(shtab.complete(parser, shell))


def manual(parser: argparse.ArgumentParser) -> str:
    """Manual page of the program in roff, with all commands and options; ExternalError without argparse-manpage."""
    manpage = extra("argparse_manpage.manpage", "argparse-manpage", "malus manual", "shell")
    return str(manpage.Manpage(parser))


def _parsers(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """A parser and the parsers of its commands."""
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                yield from _parsers(command)
