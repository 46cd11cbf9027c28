"""Qualification of a microscope from a folder of frames or a log."""
