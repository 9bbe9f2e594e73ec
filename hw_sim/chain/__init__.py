"""A row of electro-active glass targets on one laser beam, a camera each (thesis ch. 4)."""
