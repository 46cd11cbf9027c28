"""Files that arrive in an export folder, for bench_watch.py and bench_share.py."""
