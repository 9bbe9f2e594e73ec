"""The commands of a page of docs/, as a reader types them."""

import re

from support.places import DOCS


def commands_of(page: str, section: str = "") -> list[str]:
    """The indented lines of a page, or of its section that begins so, whole; the outputs are fenced."""
    text = (DOCS / page).read_text()
    if section:
        (text,) = [part for part in text.split("\n## ") if part.startswith(section)]
    lines = re.sub(r"\\\n *", "", "".join(text.split("```")[::2])).splitlines()
    return [line[4:] for line in lines if line.startswith("    ")]
