"""The effects that disparity maps show, one module for each kind."""
