"""What `semlive demo` shows after the experiment: result, truth and the report."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from rich.console import Console

from semlive.cli.shared.output_path import write_text
from semlive.cli.shared.progress_bar import multi_stage_progress, progress_bar
from semlive.cli.shared.tables import result_table, score_table
from semlive.report.document.html_writer import html_page
from semlive.report.run_data import run_data
from semlive.report.run_report import run_report
from semlive.report.scoring.score import load_truth, score
from semlive.service.replay.replay import ReplayCallbacks, ReplayRequest, Source, replay


def show_result(console: Console, folder: Path, truth_file: Path) -> dict[str, Any]:
    """Print the result and the truth, and write report and scores; return them as a JSON object.

    Args:
        console: where the tables are printed.
        folder: folder of the demo; `report.html` and `score.json` are written there.
        truth_file: `truth.json` of the simulated bench.
    """
    log = folder / "log" / "demo"
    with multi_stage_progress() as progress:
        done = replay(ReplayRequest(log, source=Source.DISPARITY), ReplayCallbacks(progress))
    truth = load_truth(truth_file)
    scores = score(done.result, truth)
    page = folder / "report.html"
    with progress_bar("drawing", "figure") as drawing:
        write_text(page, html_page(run_report(run_data(log, done)), drawing))
    compared = {quantity.name: quantity.to_json() for quantity in scores}
    (folder / "score.json").write_text(json.dumps(compared, indent=1), encoding="utf-8")
    console.print(result_table(done.result))
    console.print(score_table(scores))
    if truth["clock_stretches"]:
        console.print(f"the simulator was too slow {truth['clock_stretches']} times and stretched the clock")
    console.print(f"report: {page}")
    return {"folder": str(folder), "log": str(log), "report": str(page), "score": compared}
