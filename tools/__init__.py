"""Tools that maintain the project and are not part of it."""
