"""Compiled kernels that filter and sample images with splines."""
