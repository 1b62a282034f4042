"""A parser whose errors are Malus's own: they end the program with its exit code, and suggest what may have been meant."""

from __future__ import annotations

import argparse
import difflib
import re
import sys
from collections.abc import Sequence
from typing import Any

from malus.errors import InputError


class Parser(argparse.ArgumentParser):
    """A parser that raises InputError, which ends the program with its exit code."""

    def error(self, message: str) -> None:  # type: ignore[override]
        """End the program with what is wrong, after the usage."""
        self.print_usage(sys.stderr)
        if message.endswith(": COMMAND"):
            message += " (malus --help lists the commands)"
        raise InputError(_with_the_nearest(message))

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Report an unknown option first, before argparse complains of arguments that are missing because of it."""
        if self._subparsers is None:
            args = _with_lists_of_numbers(args)
            for word in args:
                name = word.partition("=")[0]
                if word == "--":
                    break
                if name.startswith("--") and not any(known.startswith(name) for known in self._option_string_actions):
                    near = difflib.get_close_matches(name, self._option_string_actions, n=1)
                    self.error(f"{name} is unknown" + (f"; did you mean {near[0]}?" if near else ""))
        return super().parse_known_args(args, namespace)


def _with_lists_of_numbers(words: Sequence[str]) -> list[str]:
    """The words, with lists such as -45,0,45 joined to the option before them by "=": argparse would take such a list for an option."""
    joined: list[str] = []
    for word in words:
        if joined and joined[-1].startswith("--") and re.fullmatch(r"-[\d.]+(,[^,]*)+", word):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


def _with_the_nearest(message: str) -> str:
    """A message of argparse; for an invalid choice it suggests a similar valid one, if there is one, and for a file the commands."""
    wrong = re.search(r"invalid choice: '([^']*)' \(choose from (.*)\)$", message)
    if wrong and message.startswith("argument COMMAND") and wrong[1].endswith(".toml"):
        return f"{wrong[1]} is no command, expected one before it, such as malus check {wrong[1]} (malus --help lists them)"
    near = difflib.get_close_matches(wrong[1], re.findall(r"[\w-]+", wrong[2]), n=1) if wrong else []
    return f"{message[: wrong.start()]}{wrong[1]!r} is unknown; did you mean {near[0]}?" if wrong and near else message
