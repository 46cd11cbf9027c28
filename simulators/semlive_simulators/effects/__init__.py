"""Effects that can be switched on, one module for each kind."""
