"""Pictures for the README and other pages, captured from the running programs by ``make pictures``."""
