"""Effects observable in disparity maps: search, selection, tests, verdict."""
