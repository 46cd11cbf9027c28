"""The schema of the files of `semlive qualify` is the one that was agreed: files of earlier months are compared with new ones.

Run ``python tests/golden/test_qualification_schema.py`` to write it again after a deliberate change; it is only ever extended.
"""

from __future__ import annotations

import json
from pathlib import Path

from semlive.service.qualification.files import json_schema

GOLDEN = Path(__file__).with_name("qualification_schema.json")


def golden_text() -> str:
    """The golden file as it should be now."""
    return json.dumps(json_schema(), indent=1, sort_keys=True, ensure_ascii=False) + "\n"


def test_the_schema_is_the_golden_one() -> None:
    assert json.loads(golden_text()) == json.loads(GOLDEN.read_text(encoding="utf-8"))


if __name__ == "__main__":
    GOLDEN.write_text(golden_text(), encoding="utf-8")
