"""Settling at the start of rows or frames, measured at several pixel sizes and scan speeds: its law."""
