"""The evidence for a calibration, as one HTML page and one PDF for the person who must accept it.

``prediction`` and ``verdict`` compute numbers. ``content`` and its sections turn them into words, tables and
pictures, a ``document``; the plots draw. ``html`` and ``sheets`` render it as HTML and as PDF, ``write``
writes both to disk. matplotlib is an extra: only ``write`` may be imported before ``write.check_report``.
"""
