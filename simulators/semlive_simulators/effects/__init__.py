"""Effects that can be switched on, one file each."""
