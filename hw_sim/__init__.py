"""The physics of an Active Laser Target and its faults, to test ``altd`` through its own ports."""
