"""Serial ports, for all that speaks on one: opened in one way, and written and read inside the event loop."""
