"""The cost of the unit: time a stage, CPU, rate, latency and start, measured on simulated frames."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is there, as altd does
