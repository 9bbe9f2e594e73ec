"""Whether the unit tests see a defect in each room of altd; no part of altd."""
