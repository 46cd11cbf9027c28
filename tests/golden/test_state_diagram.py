"""Drawings of the documentation: the states of a run, held to the table of transitions, and the steps of a diagnosis.

Run ``python tests/golden/test_state_diagram.py`` to draw them again after a deliberate change.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from pathlib import Path

import pytest

from semlive.engine import FINAL_STATES, Cause, State
from semlive.engine.states import TRANSITIONS

sys.path.insert(0, str(Path(__file__).parent))

from drawing import svg

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE = DOCS / "reference" / "states.md"
BEGIN, END = "<!-- drawn from the table of transitions -->\n", "<!-- end of the drawing -->\n"
MAX_SOURCES = 4
"""A transition from more states than this into one state is a row of the second table and not in the drawing."""
PLACES = {
    State.IDLE: (0, 0),
    State.CONNECTING: (1, 0),
    State.READY: (2, 0),
    State.RAMPING: (3, 0),
    State.SETTLING: (4, 0),
    State.HOLDING: (5, 0),
    State.IMAGING: (6, 0),
    State.STEP_DONE: (7, 0),
    State.RESUMING: (1.5, 1.3),
    State.PAUSED: (3.95, 1.3),
    State.WARM_UP: (5.4, 1.3),
    State.CALIBRATION_GATE: (6.7, 1.3),
    State.COMPLETE: (7, -1),
    State.EMERGENCY_STOP: (0.4, 2.3),
    State.FAULT: (2.5, 2.3),
    State.STOPPING: (5.7, 2.3),
    State.ABORTED: (7, 2.3),
}
"""Column and row of each state in the drawing."""
DIAGNOSIS = {
    "disparity maps": (0, 0.5),
    "baseline and noise": (1, 0.5),
    "residual tests\nby domain": (2, -0.4),
    "screening of\nthe dictionary": (2, 0.5),
    "stepwise selection,\nat most 3 effects": (3, 0.5),
    "adequacy": (4, 0.5),
    "held-out pairs": (5, 0.5),
    "verdict": (6, 0.5),
    "other channels": (5, 1.5),
}
DIAGNOSIS_STEPS = (
    ("disparity maps", "baseline and noise"),
    ("baseline and noise", "residual tests\nby domain"),
    ("baseline and noise", "screening of\nthe dictionary"),
    ("screening of\nthe dictionary", "stepwise selection,\nat most 3 effects"),
    ("stepwise selection,\nat most 3 effects", "adequacy"),
    ("adequacy", "held-out pairs"),
    ("held-out pairs", "verdict"),
    ("adequacy", "baseline and noise"),
    ("other channels", "verdict"),
)


def transitions() -> tuple[dict[tuple[State, State], list[Cause]], list[tuple[Cause, State, list[State]]]]:
    """Causes of each transition in the drawing; and cause, target and sources of those from many states."""
    sources: dict[tuple[Cause, State], list[State]] = defaultdict(list)
    for (before, cause), after in TRANSITIONS.items():
        sources[cause, after].append(before)
    arrows: dict[tuple[State, State], list[Cause]] = defaultdict(list)
    common = []
    for (cause, after), states in sources.items():
        if len(states) > MAX_SOURCES:
            common.append((cause, after, states))
        else:
            for before in states:
                arrows[before, after].append(cause)
    return arrows, common


def tables() -> str:
    """The drawing and both tables of transitions, as Markdown."""
    arrows, common = transitions()
    lines = ["![States of a run and the transitions between them](states.svg)", "", "| from | to | causes |", "|---|---|---|"]
    lines += [f"| `{before}` | `{after}` | {', '.join(f'`{cause}`' for cause in causes)} |" for (before, after), causes in arrows.items()]
    ends = ", ".join(f"`{state}`" for state in State if state in FINAL_STATES)
    lines += [
        "",
        f"A run starts in `{State.IDLE}` and ends in {ends}. These transitions are possible from many states and not in the drawing:",
    ]
    lines += ["", "| cause | leads to | from |", "|---|---|---|"]
    lines += [f"| `{cause}` | `{after}` | {_source_text(states)} |" for cause, after, states in common]
    return "\n".join(lines) + "\n\n"


def drawings() -> dict[Path, str]:
    """SVG text of each drawing by its path."""
    arrows = [(str(before), str(after)) for before, after in transitions()[0]]
    boxes = {str(state): (column, row + 1) for state, (column, row) in PLACES.items()}
    return {
        DOCS / "reference" / "states.svg": svg(boxes, arrows, "States of a run and the transitions between them"),
        DOCS / "explanations" / "diagnosis.svg": svg(
            {label: (column, row + 0.4) for label, (column, row) in DIAGNOSIS.items()}, DIAGNOSIS_STEPS, "Steps of a diagnosis"
        ),
    }


def _source_text(states: list[State]) -> str:
    missing = [state for state in State if state not in states]
    if len(missing) > len(states):
        return ", ".join(f"`{state}`" for state in states)
    return "every state but " + ", ".join(f"`{state}`" for state in missing)


@pytest.mark.checkout
def test_the_page_shows_the_table() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert text.partition(BEGIN)[2].partition(END)[0] == tables()


@pytest.mark.checkout
def test_the_drawings_are_those_of_the_code() -> None:
    assert {path: path.read_text(encoding="utf-8") for path in drawings()} == drawings()


def test_every_transition_is_in_the_tables_and_every_state_in_the_drawing() -> None:
    text = tables()
    for cause in Cause:
        assert f"`{cause}`" in text
    for state in State:
        assert f"`{state}`" in text
    assert set(PLACES) == set(State)


if __name__ == "__main__":
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    PAGE.write_text(before + BEGIN + tables() + END + rest.partition(END)[2], encoding="utf-8")
    for path, text in drawings().items():
        path.write_text(text, encoding="utf-8")
