"""Files as they come from outside, bounded before they are read, and written whole or not at all."""
