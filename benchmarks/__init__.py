"""Cost of the unit: time per stage, CPU, rate, latency and start, measured on simulated frames."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported, as in altd
