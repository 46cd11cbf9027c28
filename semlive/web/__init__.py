"""The live page: a process of its own that only reads the log, and shows it to browsers."""
