"""Statistics that several rooms use; pure, below vision and mapping, which do not know each other."""
