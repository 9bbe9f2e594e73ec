"""Check that the unit tests detect a defect in each package of altd; not part of altd."""
