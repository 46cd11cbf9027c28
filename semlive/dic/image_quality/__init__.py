"""Judgement of frames before and after a correlation: pattern, expected noise, recommended settings, causes of failure."""
