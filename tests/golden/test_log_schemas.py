"""The schemas of the log's messages are the ones that were agreed: a change that nobody meant would make old logs unreadable."""

from __future__ import annotations

import json
from pathlib import Path

from semlive.formats.log.messages import TOPICS, json_schema

GOLDEN = Path(__file__).with_name("log_schemas.json")


def golden_text() -> str:
    """The golden file as it should be now.

    After a deliberate change, write it again and read its difference before it is committed::

        python tests/golden/test_log_schemas.py
    """
    schemas = {topic: json.loads(json_schema(topic)) for topic in sorted(TOPICS)}
    return json.dumps(schemas, indent=1, sort_keys=True, ensure_ascii=False) + "\n"


def test_the_schemas_are_the_golden_ones() -> None:
    agreed, now = json.loads(GOLDEN.read_text(encoding="utf-8")), json.loads(golden_text())
    changed = sorted(topic for topic in agreed.keys() | now.keys() if agreed.get(topic) != now.get(topic))
    assert not changed, (
        f"the schemas of {', '.join(changed)} are not those of {GOLDEN.name}; if that is meant and old logs still read, "
        f"run: python tests/golden/{Path(__file__).name}"
    )


if __name__ == "__main__":
    GOLDEN.write_text(golden_text(), encoding="utf-8")
