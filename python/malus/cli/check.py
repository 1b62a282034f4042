"""`malus check`: what a run of a station or an object would do."""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path
from typing import Any

import malus
from malus.campaign import kinds_of, require_kind
from malus.cli.output import print_lines
from malus.cli.settings import options_of
from malus.errors import InputError
from malus.object import Object


def check_inputs(args: argparse.Namespace) -> None:
    """Print the plan of a run; errors of the inputs are raised."""
    if "object" in kinds_of(args.station):
        if args.overlay is not None:
            raise InputError(
                f"--overlay {args.overlay}: is a picture of one station, expected its file instead of an object's"
            )
        thing = Object.load(args.station)
        plans = thing.check(options_of(args, thing.campaign.options), threads=args.threads)
        surface, surface_seconds = thing.planned_surface(plans)
        stations_seconds = sum(plan["seconds"] for plan in plans)
        seconds = stations_seconds + surface_seconds
        if args.json:
            said = {"does": surface, "seconds": surface_seconds}
            print(json.dumps({"name": thing.name, "stations": plans, "surface": said, "seconds": seconds}))
            return
        if args.quiet:
            _print_warnings(*plans)
            return
        count = "1 station" if len(plans) == 1 else f"{len(plans)} stations"
        print(f"object {thing.name}: {count}, {stations_seconds:.0f} s one after another")
        print_lines(f"  {surface}: {surface_seconds:.0f} s")
        print(f"expected: about {seconds:.0f} s in all")
        for plan in plans:
            _print_plan(plan)
        return
    require_kind(args.station, "station")
    station = malus.Station.load(args.station)
    overlay = args.overlay
    if overlay is None and os.access(".", os.W_OK):
        overlay = Path(f"{args.station.stem}-check.png")
    plan = malus.check(station, options_of(args), overlay=overlay, threads=args.threads)
    plan["overlay"] = overlay and str(overlay)
    if args.json:
        print(json.dumps(plan))
    elif args.quiet:
        _print_warnings(plan)
    else:
        _print_plan(plan)


def _name_of(plan: dict[str, Any]) -> str:
    # Of an object: the name in folders and tables, as the stations' own names may be alike.
    return f"{plan['station']} ({plan['name']})" if "station" in plan else str(plan["name"])


def _print_warnings(*plans: dict[str, Any]) -> None:
    """Print the warnings alone, on standard error as a run does; of an object's stations each with the station's name."""
    for plan in plans:
        of = f"{_name_of(plan)}: " if "station" in plan else ""
        for warning in plan["warnings"]:
            print_lines(f"warning: {of}{warning}", to=sys.stderr)


def _print_plan(plan: dict[str, Any]) -> None:
    print(f"station {_name_of(plan)}: {plan['width']} x {plan['height']} px, {plan['object_pixels']:.0f} on the object")
    print_lines(*(f"  {line}" for line in plan["does"]))
    print(f"expected: about {plan['seconds']:.0f} s and {plan['memory_mb']:.0f} MB of memory")
    print_lines(*([f"warning: {warning}" for warning in plan["warnings"]] or ["no warnings"]))
    if "overlay" in plan:
        picture = plan["overlay"] or "none, this folder cannot be written to (--overlay)"
        shown = (
            "the coarse surface on the image"
            if any(line.startswith("prior:") for line in plan["does"])
            else "image and mask"
        )
        print(f"picture of {shown}: {picture}")
