"""Instruments: the quantities of each kind of unit, and the solver that computes them."""
