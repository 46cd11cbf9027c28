"""A complete run over Modbus RTU: load frame and stage are two units on one serial line."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
import yaml

from semlive.cli.shared.simulated_run import daemon_config
from semlive.cli.shared.simulator import running_simulator

from ..waiting import RUN_END_S, logged

RATE = 20.0
SCENARIO = """
extends: paper_x200
scan: {width_px: 256, height_px: 221, frame_time_s: 6.0}
export: {databar_rows: 0}
experiment:
  protocol:
    calibration_shifts_px: [[6, 0]]
    translation_shifts_px: []
    loads_n: [100]
"""


class Webhook(BaseHTTPRequestHandler):
    """A web server that keeps the titles of alerts."""

    def do_POST(self) -> None:
        alert = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        self.server.titles.append(alert["title"])  # type: ignore[attr-defined]
        self.send_response(200)
        self.end_headers()

    def log_message(self, format: str, *args: object) -> None:
        del format, args


@pytest.fixture
def webhook() -> Iterator[Any]:
    server: Any = ThreadingHTTPServer(("127.0.0.1", 0), Webhook)
    server.titles = []
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield server
    server.shutdown()
    server.server_close()


def test_a_run_from_begin_to_end_with_two_units_on_one_line(tmp_path: Path, webhook: Any) -> None:
    (tmp_path / "small.yaml").write_text(SCENARIO, encoding="utf-8")
    with running_simulator(str(tmp_path / "small.yaml"), tmp_path / "bench", RATE, rtu=True) as bench:
        config = daemon_config(bench, RATE)
        links = [config[item]["settings"] for item in ("load_frame", "stage")]
        assert [(link["serial"]["port"], link["unit"]) for link in links] == [(bench["rtu_port"], 1), (bench["rtu_port"], 7)]
        config["dic"] = {"subset_px": 31, "step_px": 8, "roi_px": None}
        config["estimate"] = {"accept_poor_calibration": True}
        config["protocol"]["load_tolerance_n"] = 20.0
        (tmp_path / "alerts.txt").write_text(f"json://127.0.0.1:{webhook.server_address[1]}\n", encoding="utf-8")
        config["alerts"] = {"file": "alerts.txt"}
        (tmp_path / "run.yaml").write_text(yaml.safe_dump(config), encoding="utf-8")
        command = [sys.executable, "-m", "semlive", "run", str(tmp_path / "run.yaml"), "--no-page", "--stop-on-fault"]
        done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=RUN_END_S, check=False)
    assert done.returncode == 0, done.stderr
    assert webhook.titles == ["demo: complete"]
    log = tmp_path / "log" / "demo"
    assert [item["pair"] for item in logged(log, "/pair")] == [0, 1]
    assert [item["what"] for item in logged(log, "/command")].count("move_stage") == 2
    assert logged(log, "/pair")[1]["loads"][0]["mean_n"] == pytest.approx(100, abs=20)
    assert not [item["what"] for item in logged(log, "/fault") if "did not confirm" in item["what"]]
