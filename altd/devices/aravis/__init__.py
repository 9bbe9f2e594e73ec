"""GigE Vision cameras through Aravis."""

from pathlib import Path

DEBIAN_GI = Path("/usr/lib/python3/dist-packages/gi")
"""PyGObject of Debian's package python3-gi, which a virtual environment hides."""


def remedy_of(error: Exception) -> str:
    """Return what helps after ``error`` of importing gi, or of loading Aravis' typelib with it."""
    if isinstance(error, ValueError):  # gi is there, the typelib is not
        return "sudo apt-get install gir1.2-aravis-0.8"
    if isinstance(error, ImportError) and error.name == "gi" and DEBIAN_GI.is_dir():
        return (
            "this Python does not see the installed python3-gi: make its environment with "
            "/usr/bin/python3 -m venv --system-site-packages, or pip install 'altd[aravis]' in it"
        )
    return "sudo apt-get install python3-gi gir1.2-aravis-0.8"
