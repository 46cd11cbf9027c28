"""The operator is told once when what the model leaves stops being noise."""

from __future__ import annotations

from semlive.service.analysis.warnings import new_warnings

LEFT = "WARNING: the model leaves {} px unexplained, 1.6 times what the correlation says of its noise"
HALVES = "WARNING: distortions from odd and even pairs differ by 0.01 px rms where noise gives 0.002 px (6 sigma)"


def test_each_thing_is_told_once_whatever_its_figures() -> None:
    news, warned = new_warnings(("consistency: all is well", LEFT.format(0.02)), frozenset())
    assert news == (LEFT.format(0.02).removeprefix("WARNING: "),)
    assert new_warnings((), warned) == ((), warned)
    assert new_warnings((LEFT.format(0.03),), warned) == ((), warned)
    news, warned = new_warnings((LEFT.format(0.03), HALVES), warned)
    assert news == (HALVES.removeprefix("WARNING: "),)
    assert new_warnings((HALVES, LEFT.format(0.04)), warned)[0] == ()
