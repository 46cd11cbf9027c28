"""Qualification of a microscope: figures with intervals, what limits the strain, and a protocol, from frames without load."""
