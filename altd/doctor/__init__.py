"""What is missing or wrong on this computer for a config, each with the command that mends it."""
