"""Conditions before a hold ends or a load is applied: adaptive hold, calibration gate, warm-up gate."""
