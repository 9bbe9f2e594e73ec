"""Pictures for the README, made from the running programs by ``make docs``."""
