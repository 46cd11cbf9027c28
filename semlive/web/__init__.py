"""The live page: a separate process that only reads the log, and shows it to browsers."""
