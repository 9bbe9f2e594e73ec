"""From the broker into PostgreSQL, for many units; runs elsewhere than on a unit."""
