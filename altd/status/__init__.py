"""State that every interface may read: the board, health, the measurement object."""
