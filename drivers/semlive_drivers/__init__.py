"""Drivers for load frames, stages and triggers."""
