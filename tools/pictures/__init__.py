"""Pictures for the README, captured from the running programs by ``make docs``."""
