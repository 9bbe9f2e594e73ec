"""What the unit costs: time a stage, CPU, rate, latency and start, measured on simulated frames."""
