"""What the unit's page takes in a browser: memory over an hour, and time to show a year."""
