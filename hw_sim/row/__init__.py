"""A row of electro-active glass targets on one laser beam, each with its own camera (thesis ch. 4)."""
