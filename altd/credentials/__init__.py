"""Credentials of users and of the unit: passwords, tokens, certificates, in files."""
