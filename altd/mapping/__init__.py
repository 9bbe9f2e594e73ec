"""Pure code: px ↔ mm by bivariate tensor polynomials on a Gram basis (thesis ch. 3.5) and lens models."""
