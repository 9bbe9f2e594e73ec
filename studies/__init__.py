"""The thesis' experiments on simulated units, measured by altd as a stranger would use it.

A study is a module with ``TITLE``, ``QUESTION`` and ``run(progress) -> Result``. Only here may the simulator
know altd's measuring rooms.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported, as in altd
