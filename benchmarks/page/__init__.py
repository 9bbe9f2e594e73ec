"""The unit's page in a browser: memory over an hour, and time to show a year."""
