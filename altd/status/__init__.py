"""What every face may read: the board, health, the measurement object."""
