"""Digital image correlation: from two frames to a disparity map."""
