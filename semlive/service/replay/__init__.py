"""Replay of logs, and import of disparity maps of other programs."""
