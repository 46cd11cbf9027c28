"""Devices that the operator moves, triggers or reads on request."""
