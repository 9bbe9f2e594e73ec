"""The unit's page in a browser: memory over an hour, and the time to show a year."""
