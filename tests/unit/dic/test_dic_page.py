"""docs/how-to/correlate.md: its examples run, and its table lists every status."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from semlive import dic

pytestmark = pytest.mark.checkout
PAGE = Path(__file__).parents[3] / "docs" / "how-to" / "correlate.md"


def test_examples_run_as_they_stand(lab, tmp_path, monkeypatch):
    text = PAGE.read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    texture = cv2.GaussianBlur(np.random.default_rng(1).standard_normal((884, 1024)), (0, 0), 2.0)
    for number, name in enumerate(("ref.tif", "cur.tif")):
        cv2.imwrite(name, lab.expose(128.0 + 39.0 * texture / texture.std(), 2.0, number))
    names: dict[str, object] = {}
    blocks = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    assert len(blocks) == 4
    for block in blocks:
        exec(compile(block, str(PAGE), "exec"), names)
    found = names["found"]
    assert isinstance(found, dic.DisparityMap)
    assert found.valid.mean() > 0.9
    assert isinstance(names["q"], dic.PatternQuality)
    assert isinstance(names["shifts"], dic.RowShifts)


def test_every_status_is_explained():
    words = set(re.findall(r"^\| `(\w+)` \|", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE))
    assert words == {status.label for status in dic.PoiStatus}
