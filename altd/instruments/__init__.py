"""What kinds of unit there are: the quantities of each, and how they are solved."""
