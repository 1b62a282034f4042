"""Options of the steps and lists of numbers as the command line states them, and the list of all options."""

from __future__ import annotations

import argparse
import json

import malus
from malus.cli.output import print_lines
from malus.errors import InputError
from malus.options import MAIN


def numbers_of(option: str, text: str | None, expected: str) -> list[float] | None:
    """Numbers with commas between them; InputError that names the option and what was expected."""
    try:
        return None if text is None else [float(word) for word in text.split(",")]
    except ValueError:
        raise InputError(f"{option} {text}, expected {expected}") from None


def options_of(args: argparse.Namespace, start: malus.Options | None = None) -> malus.Options:
    """The options that --preset, --options, --set and --fusion state, on top of `start` (of a campaign) or of the defaults."""
    if start is not None and args.preset:
        raise InputError("--preset: a campaign's options stand in its file, [options]")
    options = start or (malus.Options.preset(args.preset) if args.preset else malus.Options())
    if args.options:
        options.update_from_file(args.options)
    for assignment in args.set:
        options.set(assignment)
    if args.fusion:
        options.fusion = args.fusion
    return options


def list_options(preset: str | None, *, main_only: bool) -> None:
    """Print every option, the main ones, what a preset changes, or with "" the presets."""
    if preset == "":
        for name, meaning in malus.Options.presets().items():
            print(f"{name}\n    {meaning}")
        return
    values = (malus.Options() if preset is None else malus.Options.preset(preset)).to_dict()
    defaults = malus.Options().to_dict()
    if preset is not None and values["fusion"] != defaults["fusion"]:
        print(f"fusion = {json.dumps(values['fusion'])}")
    for name, kind, default, meaning in malus.Options.describe():
        section, key = name.split(".")
        value = values[section][key]
        if (preset is None or value != defaults[section][key]) and (name in MAIN or not main_only):
            print_lines(f"{name} = {json.dumps(default if preset is None else value)}  ({kind})")
            print_lines(f"    {meaning}", hang=0)
