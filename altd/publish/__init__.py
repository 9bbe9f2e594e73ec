"""The interfaces to the outside: each reads the board and owns its wire format."""
