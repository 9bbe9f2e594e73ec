"""Tools to maintain the project; they are not part of altd."""
