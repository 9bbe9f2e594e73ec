"""Physics of an Active Laser Target and its faults, to test ``altd`` through its own ports."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported, as in altd
