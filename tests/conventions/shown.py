"""Command lines that the pages show, and which test runs which."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    *sorted((ROOT / "docs").rglob("*.md")),
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "SECURITY.md", "deploy/Containerfile", "deploy/semlive@.service")),
]
WRITTEN = {"cli.md"}
"""Written from the commands, where a heading names a command without what it needs."""
LINE = re.compile(
    r"^(?: {4}(?:\S[^\n]*?[\s/\\])?|ExecStart(?:Pre)?=\S*?[\s/\\]?|RUN )(?:semlive|go\.py) ((?:[a-z]|--)[^`#\n]*)", re.MULTILINE
)
QUOTED = re.compile(r"`semlive ((?:[a-z]|--)[^`\n]*)`")

ON_A_LOG = ("replay", "report", "export", "diagnose", "experiment", "score", "recover", "dic", "simulate", "plan", "inspect")
"""Run as they are shown, on the short demo's log and frames: tests/scenario/test_demo_short.py."""
ELSEWHERE = {
    "demo": "scenario/test_demo_short.py",
    "test": "packaging/test_bootstrap.py",
    "lint": "packaging/test_bootstrap.py",
    "docs": "packaging/test_bootstrap.py",
    "init": "conventions/test_pages.py",
    "doctor": "conventions/test_pages.py",
    "frame": "contract/test_cli_frame_check.py",
    "import": "contract/logs/test_cli_import.py",
    "qualify": "contract/test_cli_qualify.py",
    "prune": "unit/service/test_retention.py",
    "reanalyse": "contract/logs/test_cli_reanalyse.py",
    "run": "browser/conftest.py",
    "serve": "browser/test_page_watch.py",
}
"""Run with what they need to be run with: a bench, a browser, maps of another engine."""


def shown(path: Path) -> list[str]:
    """Command lines of a page, without their optional parts in brackets."""
    text = path.read_text(encoding="utf-8")
    lines = [match[1] for match in LINE.finditer(text)] + [match[1] for match in QUOTED.finditer(text)]
    return [re.split(r"\s{2,}|[:;,] |\.$| \|\|", line.replace("[", " ").replace("]", " ").strip())[0] for line in lines]


CASES = [(path, line) for path in PAGES if path.exists() and path.name not in WRITTEN for line in dict.fromkeys(shown(path))]
