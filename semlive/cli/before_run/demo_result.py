"""What `semlive demo` shows after the experiment: result, truth and the report."""

from __future__ import annotations

import json
from pathlib import Path

from rich.console import Console

from semlive.cli.shared.output_path import write_text
from semlive.cli.shared.progress_bar import multi_stage_progress, progress_bar
from semlive.cli.shared.tables import result_table, score_table
from semlive.report.page import report_html
from semlive.report.scoring.score import load_truth, score
from semlive.service.log.run_facts import log_facts
from semlive.service.replay.replay import ReplayCallbacks, load_series, result_from_maps


def show_result(console: Console, folder: Path, truth_file: Path) -> None:
    """Print the result and the truth, and write report and scores.

    Args:
        console: where the tables are printed.
        folder: folder of the demo; `report.html` and `score.json` are written there.
        truth_file: `truth.json` of the simulated bench.
    """
    log = folder / "log" / "demo"
    with multi_stage_progress() as progress:
        result, settings = result_from_maps(log, ReplayCallbacks(progress))
    truth = load_truth(truth_file)
    scores = score(result, truth)
    page = folder / "report.html"
    with progress_bar("drawing", "figure") as drawing:
        write_text(page, report_html("demo", result, load_series(log), settings, log_facts(log), drawing))
    (folder / "score.json").write_text(json.dumps({quantity.name: quantity.to_json() for quantity in scores}, indent=1), encoding="utf-8")
    console.print(result_table(result))
    console.print(score_table(scores))
    if truth["clock_stretches"]:
        console.print(f"the simulator was too slow {truth['clock_stretches']} times and stretched the clock")
    console.print(f"report: {page}")
