"""Effects that load, extension and stage readings show."""
