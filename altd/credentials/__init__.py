"""Who may act on the unit: names with hashes of passwords and tokens, in a file of their own."""
