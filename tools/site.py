"""A hook of MkDocs (``mkdocs.yml``): links of a page to files of the repository outside ``docs/``.

Such a file is copied into the site under ``repository/``, and the link follows it. A link to a missing file
stays as it is, so that the strict build names it.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import TYPE_CHECKING

from mkdocs.structure.files import File, Files

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.pages import Page

REPOSITORY = Path(__file__).resolve().parents[1]
_LINK = re.compile(r"(?<=\]\()(\.\./[^)#\s]*)")


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """The page with its links out of ``docs/`` turned to the copies."""

    def copied(match: re.Match[str]) -> str:
        path = posixpath.normpath(posixpath.join("docs", posixpath.dirname(page.file.src_uri), match[0]))
        if path.startswith("docs/") or not (REPOSITORY / path).is_file():
            return match[0]
        name = f"repository/{path}" if not path.endswith(".md") else f"repository/{path}.txt"
        if name not in files.src_uris:
            files.append(File.generated(config, name, abs_src_path=str(REPOSITORY / path)))
        return posixpath.relpath(name, posixpath.dirname(page.file.src_uri) or ".")

    return _LINK.sub(copied, markdown)
