"""The thesis' experiments on simulated units, measured by altd as a stranger would use it.

A study is a module with ``TITLE``, ``QUESTION`` and ``run(progress) -> Result``. Only here may the simulator
know altd's measuring rooms.
"""
