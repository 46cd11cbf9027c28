"""The effects that disparity maps show, one file each."""
