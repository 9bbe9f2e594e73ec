"""The kinds of unit: the quantities of each, and their solution."""
