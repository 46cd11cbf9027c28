"""The forward model: named effects that predict where a material point is written."""
