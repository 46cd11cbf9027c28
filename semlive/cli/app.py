"""All commands, by name."""

from __future__ import annotations

import os
import sys
import threading
from typing import Annotated

import typer

from semlive.cli.lazy import CommandEntry, group_of
from semlive.data.text import printable
from semlive.errors import BadInput, SemliveError

_HELP = """Live drift- and distortion-corrected strain measurement inside a scanning electron microscope.

New here: semlive demo runs a whole simulated experiment. At an instrument: semlive init writes a configuration, semlive doctor says whether everything is in place, semlive plan shows the experiment before it is run, semlive run runs it."""  # noqa: E501
_EPILOG = "semlive COMMAND --help says what a command does and what it takes; semlive --install-completion completes names by the tab key."

PANEL_SETUP, PANEL_RUN, PANEL_ANALYSIS, PANEL_TOOLS = "Before a run", "A run", "After a run", "Without a run"
COMMANDS = (
    CommandEntry(
        "demo",
        "semlive.cli.demo:demo",
        "Run a simulated in-situ tensile experiment through the daemon and compare the result with the truth.",
        PANEL_SETUP,
    ),
    CommandEntry("init", "semlive.cli.init:init", "Write a commented configuration after a few questions.", PANEL_SETUP),
    CommandEntry(
        "doctor",
        "semlive.cli.doctor:doctor",
        "Look whether everything a run needs is in place, and say how to mend what is not; nothing is moved.",
        PANEL_SETUP,
    ),
    CommandEntry(
        "plan",
        "semlive.cli.plan:plan",
        "Show an experiment before it is run: time, frames, dose, noise, false strain, how far each fault can carry the load, and advice.",
        PANEL_SETUP,
    ),
    CommandEntry(
        "inspect",
        "semlive.cli.inspect:inspect",
        "Show what exported images say of their scan, where each value comes from, and what is missing.",
        PANEL_SETUP,
    ),
    CommandEntry("frame", "semlive.cli.frame:frame", "Look at a load frame, without moving it.", PANEL_SETUP),
    CommandEntry(
        "run",
        "semlive.cli.run:run",
        "Run an experiment; type pause, resume, stop, abort or acknowledge and press Enter, or Ctrl-C to stop.",
        PANEL_RUN,
    ),
    CommandEntry("serve", "semlive.cli.serve:serve", "Show a log on the live page until Ctrl-C; nothing can be steered there.", PANEL_RUN),
    CommandEntry(
        "recover",
        "semlive.cli.recover:recover",
        "Make a torn or damaged log valid: all that is whole, with an index, and a list of what was lost.",
        PANEL_RUN,
    ),
    CommandEntry(
        "replay",
        "semlive.cli.replay:replay",
        "Recompute the analysis from a log and compare it with what the live run recorded.",
        PANEL_ANALYSIS,
    ),
    CommandEntry(
        "report",
        "semlive.cli.report:report",
        "Write a run as one page: figures as in the method's paper, uncertainty budget, refused frames, settings, versions.",
        PANEL_ANALYSIS,
    ),
    CommandEntry(
        "export",
        "semlive.cli.export:export",
        "Write corrected displacement and strain of every frame, drift, distortion, series and configuration.",
        PANEL_ANALYSIS,
    ),
    CommandEntry(
        "prune",
        "semlive.cli.prune:prune",
        "Name old runs beyond a limit, and delete them with --delete; a run that is not complete or holds other files is always kept.",
        PANEL_ANALYSIS,
    ),
    CommandEntry(
        "reanalyse",
        "semlive.cli.reanalyse:reanalyse",
        "Analyse logs anew; what goes wrong with one does not stop the rest.",
        PANEL_ANALYSIS,
    ),
    CommandEntry(
        "diagnose",
        "semlive.cli.diagnose:diagnose",
        "Find where model and data disagree, name the missing effect, and show how much of the gap it closes.",
        PANEL_ANALYSIS,
    ),
    CommandEntry(
        "experiment",
        "semlive.cli.experiment:experiment",
        "Propose the experiment that decides what a diagnosis leaves open; decide by it; compare a run with simulations of it.",
        PANEL_ANALYSIS,
    ),
    CommandEntry(
        "score",
        "semlive.cli.score:score",
        "Every recovered quantity against truth, with its uncertainty, and whether the stated uncertainties hold.",
        PANEL_ANALYSIS,
    ),
    CommandEntry(
        "dic", "semlive.cli.dic:dic", "Correlate images (TIFF, PNG, JPEG, BMP...) with a reference: x_current = x + u, in px.", PANEL_TOOLS
    ),
    CommandEntry(
        "import",
        "semlive.cli.import_maps:import_maps",
        "Make a log of disparity maps that another engine made: VIC-2D, DICe, OpenCorr, pyvale, or plain CSV.",
        PANEL_TOOLS,
    ),
    CommandEntry(
        "simulate",
        "semlive.cli.simulate:simulate",
        "Play a scenario's own experiment as fast as it renders, and write what the microscope would have exported.",
        PANEL_TOOLS,
    ),
)
app = typer.Typer(cls=group_of(COMMANDS), help=_HELP, epilog=_EPILOG, no_args_is_help=True, pretty_exceptions_enable=False)


def _say_version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version  # noqa: PLC0415

        typer.echo(f"semlive {version('semlive')}")
        raise typer.Exit


@app.callback()
def _semlive(
    version: Annotated[bool, typer.Option("--version", callback=_say_version, is_eager=True, help="Say which version this is.")] = False,
) -> None:
    del version


def run_app() -> int:
    """Run the command that the arguments name and give its exit code.

    Nobody at an instrument reads a traceback: an error is one line, and `SEMLIVE_TRACEBACK=1` shows where it arose.
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
    what = printable(" ".join(str(error).split()))
    return f"semlive itself failed ({type(error).__name__}: {what}); set SEMLIVE_TRACEBACK=1 and run it again to see where, and report it"


def _thread_failed(failed: threading.ExceptHookArgs) -> None:
    if failed.exc_value is not None and not isinstance(failed.exc_value, SystemExit):
        sys.stderr.write(f"{_unexpected(failed.exc_value)}\n")
