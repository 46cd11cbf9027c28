"""Effects that disparity maps show: search, selection, tests, verdict."""
