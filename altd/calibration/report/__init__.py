"""The evidence for a calibration, as one HTML page and one PDF for the person who must accept it.

``prediction`` and ``verdict`` are numbers. ``content`` and its sections put them into words, tables and
pictures, a ``document``; the plots draw. ``page`` and ``sheets`` set that as HTML and as PDF, ``write`` puts
both on disk. matplotlib is an extra: only ``write`` may be imported before ``write.check_report``.
"""
