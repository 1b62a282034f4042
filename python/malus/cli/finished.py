"""Commands on finished workspaces: report, export and compare."""

from __future__ import annotations

import argparse
from pathlib import Path

import malus
from malus._files import resolved
from malus.campaign import require_kind
from malus.change import change_summary
from malus.cli.output import print_lines, view_of
from malus.errors import InputError


def work_to_report(args: argparse.Namespace) -> Path:
    """The workspace of `malus report WORK`, or of `malus report STATION.toml -o WORK`; InputError if it is another station's."""
    if args.output is None:
        return Path(args.work)
    require_kind(args.work, "station")
    malus.Station.load(args.work)
    belongs = malus.Workspace(args.output).manifest["station"]
    files = [Path(belongs["file"]), args.output / belongs["file_from_here"]] if belongs["file"] else []
    if resolved(args.work) not in map(resolved, files):
        raise InputError(
            f"-o {args.output}: belongs to station {belongs['name']!r} of {belongs['file'] or 'arrays'}, expected the workspace of "
            f"{args.work}"
        )
    return Path(args.output)


def exported(args: argparse.Namespace) -> Path:
    """Write what `malus export` asks for; returns its path."""
    return malus.export(
        args.work,
        args.format,
        args.output,
        faces=args.faces,
        interval=args.interval,
        y_up=args.y_up,
        albedo=args.albedo,
        chart=args.chart,
        url=args.url,
        trim=args.trim,
        fill=args.fill,
        threads=args.threads,
    )


def compare_dates(args: argparse.Namespace) -> None:
    """Compare two workspaces, and print what changed."""
    with view_of(args) as view:
        view.expect([("compare", 20.0)])
        change = malus.compare(
            args.before,
            args.after,
            args.output,
            same_frame=args.same_frame,
            threads=args.threads,
            progress=lambda fraction, message: view.progress("compare", fraction, message),
        )
        if args.json or args.quiet:  # otherwise the summary prints the warnings
            for warning in change.figures["warnings"]:
                view.log("warning", warning)
    if not (args.json or args.quiet):
        print_lines(*change_summary(change.figures), f"  page: {change.folder / 'index.html'}")
