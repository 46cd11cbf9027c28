"""Compiled kernels of the correlation of subsets: sums, IC-GN, shape functions."""
