"""Effects that shift image rows relative to each other."""
