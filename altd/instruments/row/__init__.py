"""The instrument ``chain``: switchable glass targets in a row on one beam (thesis ch. 4, docs/chain.md)."""
