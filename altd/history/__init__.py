"""What the unit measured and what happened to it, in a SQLite file that outlives restarts and power cuts."""
