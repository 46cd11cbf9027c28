"""Figures of a qualification with their 95 % intervals: drift, distortion, rows, noise and stage."""
