"""All commands, by name."""

from __future__ import annotations

import sys

import typer

from semlive.cli.demo import demo
from semlive.cli.dic import dic
from semlive.cli.replay import replay
from semlive.cli.report import report
from semlive.cli.run import run
from semlive.cli.score import score
from semlive.cli.simulate import simulate
from semlive.errors import BadInput, SemliveError

_HELP = "Live drift- and distortion-corrected strain measurement inside a scanning electron microscope."
app = typer.Typer(help=_HELP, no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False)
app.command("demo")(demo)
app.command("run")(run)
app.command("replay")(replay)
app.command("report")(report)
app.command("score")(score)
app.command("simulate")(simulate)
app.command("dic")(dic)


def run_app() -> int:
    """Run the command that the arguments name and give its exit code."""
    try:
        app()
    except SystemExit as ended:
        return ended.code if isinstance(ended.code, int) else 1
    except SemliveError as error:
        sys.stderr.write(f"{error}\n")
        return 2 if isinstance(error, BadInput) else 1
    return 0
