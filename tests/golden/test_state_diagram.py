"""The diagram of states in docs/reference/states.md, held to the table of transitions.

Run ``python tests/golden/test_state_diagram.py`` to draw it anew after a deliberate change of the table.
"""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

import pytest

from semlive.engine import FINAL_STATES, Cause, State
from semlive.engine.states import TRANSITIONS

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "states.md"
BEGIN, END = "<!-- drawn from the table of transitions -->\n", "<!-- end of the drawing -->\n"
_MANY = 4
"""A cause that leads from more states than this into one is told in words under the diagram."""


def drawn() -> str:
    """The diagram, as Mermaid text, and in words what would be drawn from almost everywhere."""
    sources: dict[tuple[Cause, State], list[State]] = defaultdict(list)
    for (before, cause), after in TRANSITIONS.items():
        sources[cause, after].append(before)
    arrows: dict[tuple[State, State], list[Cause]] = defaultdict(list)
    everywhere = []
    for (cause, after), states in sources.items():
        if len(states) > _MANY:
            everywhere.append((cause, after, states))
        else:
            for before in states:
                arrows[before, after].append(cause)
    lines = ["```mermaid", "stateDiagram-v2", f"    [*] --> {State.IDLE}"]
    lines += [f"    {before} --> {after}: {', '.join(causes)}" for (before, after), causes in arrows.items()]
    lines += [f"    {state} --> [*]" for state in State if state in FINAL_STATES]
    lines += ["```", "", "| cause | leads to | from |", "|---|---|---|"]
    lines += [f"| `{cause}` | `{after}` | {_in_words(states)} |" for cause, after, states in everywhere]
    return "\n".join(lines) + "\n\n"


def _in_words(states: list[State]) -> str:
    missing = [state for state in State if state not in states]
    if len(missing) > len(states):
        return ", ".join(f"`{state}`" for state in states)
    return "every state but " + ", ".join(f"`{state}`" for state in missing)


@pytest.mark.checkout
def test_the_page_shows_the_table() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert text.partition(BEGIN)[2].partition(END)[0] == drawn()


def test_every_transition_is_in_the_drawing() -> None:
    text = drawn()
    for cause in Cause:
        assert cause in text
    for state in State:
        assert state in text


if __name__ == "__main__":
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    PAGE.write_text(before + BEGIN + drawn() + END + rest.partition(END)[2], encoding="utf-8")
