"""Text tables: disparity maps, frames, clocks."""
