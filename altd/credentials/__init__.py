"""Who may act on the unit, and what it proves itself with: passwords, tokens, certificates, in files."""
