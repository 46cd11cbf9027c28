"""All commands, by name."""

from __future__ import annotations

import errno
import os
import sys
import threading
from typing import Annotated

import typer

from semlive.cli.lazy import CommandEntry, group_of
from semlive.errors import BadInput, SemliveError
from semlive.inputs.printable import printable

_HELP = """Live drift- and distortion-corrected strain measurement inside a scanning electron microscope.

First steps: semlive demo runs a complete simulated experiment. At an instrument: semlive init writes a configuration, semlive doctor checks whether everything is in place, semlive plan shows the experiment before it is run, semlive run runs it."""  # noqa: E501
_EPILOG = "semlive COMMAND --help describes a command and its options; semlive --install-completion installs completion by the tab key."

_PATH_ERRORS = frozenset(
    (errno.EACCES, errno.EPERM, errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EISDIR, errno.ENOTDIR, errno.ENAMETOOLONG)
)
"""Errors of the operating system whose cause is a path or a disk of the user."""

PANEL_SETUP, PANEL_RUN, PANEL_ANALYSIS, PANEL_TOOLS = "Before a run", "A run", "After a run", "Without a run"
COMMANDS = (
    CommandEntry(
        "demo",
        "semlive.cli.before_run.demo:demo",
        "Run a simulated in-situ tensile experiment through the daemon and compare the result with the truth.",
        PANEL_SETUP,
    ),
    CommandEntry("init", "semlive.cli.before_run.init:init", "Write a commented configuration after a few questions.", PANEL_SETUP),
    CommandEntry(
        "doctor",
        "semlive.cli.before_run.doctor:doctor",
        "Check whether everything that a run needs is in place, and show how to correct what is not; nothing moves.",
        PANEL_SETUP,
    ),
    CommandEntry(
        "plan",
        "semlive.cli.before_run.plan:plan",
        "Show an experiment before it is run: time, frames, dose, noise, false strain, largest load after each fault, and advice.",
        PANEL_SETUP,
    ),
    CommandEntry(
        "inspect",
        "semlive.cli.before_run.inspect:inspect",
        "Show the scan parameters of exported images, the source of each value, and what is missing.",
        PANEL_SETUP,
    ),
    CommandEntry(
        "qualify",
        "semlive.cli.before_run.qualify:qualify",
        "Show what strain a microscope can measure, what limits it, and the recommended protocol, from frames without load.",
        PANEL_SETUP,
    ),
    CommandEntry("frame", "semlive.cli.before_run.frame:frame", "Check a load frame without moving it.", PANEL_SETUP),
    CommandEntry(
        "run",
        "semlive.cli.during_run.run:run",
        "Run an experiment; type pause, resume, stop, abort or acknowledge and press Enter, or Ctrl-C to stop.",
        PANEL_RUN,
    ),
    CommandEntry(
        "serve", "semlive.cli.during_run.serve:serve", "Show a log on the live page until Ctrl-C; the page cannot control a run.", PANEL_RUN
    ),
    CommandEntry(
        "recover",
        "semlive.cli.during_run.recover:recover",
        "Repair a truncated or damaged log: keep every complete message, write an index, and list what was lost.",
        PANEL_RUN,
    ),
    CommandEntry(
        "replay",
        "semlive.cli.after_run.replay:replay",
        "Repeat the analysis of a log and compare the result with the one that the live run recorded.",
        PANEL_ANALYSIS,
    ),
    CommandEntry(
        "report",
        "semlive.cli.after_run.report:report",
        "Write a run in the form of a paper: instrument, protocol, calibration, results, uncertainty budget, limits, settings, files.",
        PANEL_ANALYSIS,
    ),
    CommandEntry(
        "export",
        "semlive.cli.after_run.export:export",
        "Write corrected displacement and strain of every frame, drift, distortion, series and configuration.",
        PANEL_ANALYSIS,
    ),
    CommandEntry(
        "prune",
        "semlive.cli.after_run.prune:prune",
        "List old runs beyond a limit, and delete them with --delete; a run that is incomplete or holds other files is always kept.",
        PANEL_ANALYSIS,
    ),
    CommandEntry(
        "reanalyse",
        "semlive.cli.after_run.reanalyse:reanalyse",
        "Analyse several logs again; the failure of one log does not stop the others.",
        PANEL_ANALYSIS,
    ),
    CommandEntry(
        "diagnose",
        "semlive.cli.after_run.diagnose:diagnose",
        "Find where model and data disagree, identify the missing effect, and show how much of the gap it closes.",
        PANEL_ANALYSIS,
    ),
    CommandEntry(
        "experiment",
        "semlive.cli.after_run.experiment:experiment",
        "Propose an experiment that decides between possible effects, evaluate it, or compare a run with simulations of it.",
        PANEL_ANALYSIS,
    ),
    CommandEntry(
        "score",
        "semlive.cli.after_run.score:score",
        "Compare every recovered quantity with its true value, and check whether the stated uncertainties hold.",
        PANEL_ANALYSIS,
    ),
    CommandEntry(
        "dic",
        "semlive.cli.without_run.dic:dic",
        "Correlate images (TIFF, PNG, JPEG, BMP...) with a reference: x_current = x + u, in px.",
        PANEL_TOOLS,
    ),
    CommandEntry(
        "import",
        "semlive.cli.without_run.import_maps:import_maps",
        "Write a log from disparity maps of another DIC program: VIC-2D, DICe, OpenCorr, pyvale, or plain CSV.",
        PANEL_TOOLS,
    ),
    CommandEntry(
        "simulate",
        "semlive.cli.without_run.simulate:simulate",
        "Simulate the experiment of a scenario without the daemon, and write the files that the microscope would export.",
        PANEL_TOOLS,
    ),
)
app = typer.Typer(cls=group_of(COMMANDS), help=_HELP, epilog=_EPILOG, no_args_is_help=True, pretty_exceptions_enable=False)


def _print_version(requested: bool) -> None:
    if requested:
        from importlib.metadata import version  # noqa: PLC0415

        typer.echo(f"semlive {version('semlive')}")
        raise typer.Exit


@app.callback()
def _semlive(
    version: Annotated[bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")] = False,
) -> None:
    del version


def run_app() -> int:
    """Run the command that the arguments name, and return its exit code.

    An error is one line on standard error; with `SEMLIVE_TRACEBACK=1` in the environment a traceback follows.
    """
    traced = bool(os.environ.get("SEMLIVE_TRACEBACK"))
    if not traced:
        threading.excepthook = _thread_failed
    try:
        app()
    except SystemExit as ended:
        return ended.code if isinstance(ended.code, int) else 1
    except SemliveError as error:
        sys.stderr.write(f"{printable(str(error))}\n")
        return 2 if isinstance(error, BadInput) else 1
    except Exception as error:
        if traced:
            raise
        sys.stderr.write(f"{_unexpected(error)}\n")
        return 1
    return 0


def _unexpected(error: BaseException | None) -> str:
    if isinstance(error, OSError) and error.errno in _PATH_ERRORS and error.filename is not None:
        return f"{printable(str(error.filename))}: {error.strerror}; make room or change the rights, or give another path"
    message = printable(" ".join(str(error).split()))
    return (
        f"semlive itself failed ({type(error).__name__}: {message}); set SEMLIVE_TRACEBACK=1 and run it again to see where, and report it"
    )


def _thread_failed(failure: threading.ExceptHookArgs) -> None:
    if failure.exc_value is not None and not isinstance(failure.exc_value, SystemExit):
        sys.stderr.write(f"{_unexpected(failure.exc_value)}\n")
