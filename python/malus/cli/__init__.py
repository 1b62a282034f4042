"""The command line: `malus run STATION.toml -o WORK` and its parts."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from collections.abc import Sequence
from io import TextIOWrapper

import malus
from malus import studio
from malus._files import require_utf8
from malus.chart import measure_chart
from malus.cli.arguments import STEP_COMMANDS, command_line
from malus.cli.check import check_inputs
from malus.cli.finished import compare_dates, exported, work_to_report
from malus.cli.many import run_batch, run_object_file
from malus.cli.output import print_lines, tell_written
from malus.cli.settings import list_options, numbers_of, options_of
from malus.cli.station import make_paper, reconstruct_station
from malus.demo import example_station
from malus.errors import InputError, ending_of
from malus.progress import nobody_reads
from malus.shell import completion, manual
from malus.threads import ALL_CORES

INTERRUPTED = 130


def _run(arguments: Sequence[str] | None) -> None:
    for text in sys.argv[1:] if arguments is None else arguments:
        require_utf8(text)
    args = command_line().parse_args(arguments)
    if args.command == "completion":
        print(completion(command_line(), args.shell))
        return
    if args.command == "manual":
        print(manual(command_line()))
        return
    if args.command == "options":
        list_options(args.preset, main_only=args.main)
        return
    if args.command == "import":
        print(
            malus.import_station(
                args.folder,
                args.output,
                table=args.table,
                pattern=args.pattern,
                angles=numbers_of("--angles", args.angles, "angles in degrees: 0,45,90,135"),
                mosaic=numbers_of("--mosaic", args.mosaic, "four angles in degrees: 90,45,135,0"),
                colors=args.colors,
                metashape=args.metashape,
                label=args.label,
                cloud=args.cloud,
                unit=args.unit,
            )
        )
        return
    if args.command == "chart":
        corners = numbers_of("--corners", args.corners, "eight numbers: x,y of four patches")
        correction = measure_chart(
            args.source,
            corners=corners,
            response=args.response,
            white_level=args.white_level,
            black_level=args.black_level,
        )
        print(correction.save(args.output), correction.summary(), sep="\n")
        return
    if args.command == "studio":
        studio.serve(args.folder, port=args.port, browser=not args.no_browser)
        return
    if args.threads is None and args.command not in ("batch", "object"):  # these divide the cores among their jobs
        args.threads = ALL_CORES
    if args.threads is not None and args.threads < 1:
        raise InputError(f"--threads {args.threads}, expected at least 1")
    if args.command in ("report", "view", "export", "compare"):
        options_of(args)  # options of steps that are done: they change nothing here, but mistakes in them are reported
    if args.command == "check":
        check_inputs(args)
    elif args.command == "report":
        tell_written(args, "report", malus.write_report(work_to_report(args)))
    elif args.command == "view":
        tell_written(args, "view", malus.open_report(args.work))
    elif args.command == "export":
        tell_written(args, "export", exported(args))
    elif args.command == "compare":
        compare_dates(args)
    elif args.command == "batch":
        run_batch(args)
    elif args.command == "object":
        run_object_file(args)
    elif args.command == "demo":
        reconstruct_station(args, example_station(args.example))
    elif args.command == "paper":
        make_paper(args)
    else:
        reconstruct_station(args, args.station, *STEP_COMMANDS.get(args.command, (None, None))[:2])


def _start_with_utf8() -> None:
    """Restart the program in UTF-8 mode if the locale has another encoding: the C++ library takes file names in UTF-8."""
    if sys.getfilesystemencoding() != "utf-8":
        os.execv(sys.executable, [sys.executable, "-X", "utf8", *sys.orig_argv[1:]])


def _end_at_signals() -> None:
    """Treat the signals of a batch system or a closing shell like Ctrl-C, so that programs that the run started end, too."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    # If SIGHUP is ignored (nohup), the user wants the run to continue without its shell.
    if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
        signal.signal(signal.SIGHUP, signal.default_int_handler)


def _flush_output() -> None:
    try:
        sys.stdout.flush()
    except OSError as error:
        raise OSError(error.errno, error.strerror, "standard output") from None


def _drop_unwritten_output() -> None:
    """Discard output that cannot be written: at exit Python would try again, print an error, and change the exit code to 120."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            with contextlib.suppress(OSError):  # in tests it is no file
                null = os.open(os.devnull, os.O_WRONLY)
                os.dup2(null, stream.fileno())
                os.close(null)
        except ValueError:  # standard error is closed above
            pass


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code (0, 2, 3, 4, 5 or 130; see malus.errors)."""
    if arguments is None:
        _start_with_utf8()
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by whoever started the program, as by >&-
            setattr(sys, name, open(os.devnull, "w"))
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # a character that a terminal cannot show must not end a run
            stream.reconfigure(errors="backslashreplace")
    _end_at_signals()
    try:
        try:
            _run(arguments)
        except SystemExit:  # of --help and --version
            _flush_output()
            raise
        _flush_output()
    except KeyboardInterrupt:
        with contextlib.suppress(BrokenPipeError):
            print("malus: interrupted; finished steps are kept and will not be repeated", file=sys.stderr)
        return INTERRUPTED
    except Exception as error:
        if isinstance(error, BrokenPipeError) and nobody_reads():
            # The reader of our last lines has ended (`malus options | head`): end silently.
            sys.stderr.close()
            return 0
        if "MALUS_TRACEBACK" in os.environ:
            raise
        code, message = ending_of(error)
        print_lines(f"malus: {message}", *(f"  {note}" for note in getattr(error, "__notes__", ())), to=sys.stderr)
        return code
    finally:
        _drop_unwritten_output()
    return 0
