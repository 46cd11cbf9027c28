"""Region of interest and masks, drawn on a test frame in the browser of this computer."""

from semlive.cli.before_run.region.question import RegionAnswer, region_answer

__all__ = ["RegionAnswer", "region_answer"]
