"""Hooks of MkDocs (``mkdocs.yml``).

If a page links to a file of the repository outside ``docs/``, the file is copied into the site under
``repository/`` and the link is changed to the copy. A link to a missing file is unchanged, so that the strict
build reports it.

Browsers refuse workers on pages opened from disk, and the theme's search is a worker. The theme loads a
replacement from the network; the replacement below needs no network. In search results, the reasons and the
start page rank above the other pages, and decisions, studies and licences below them.
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
_NETWORK_SHIM = "https://unpkg.com/iframe-worker/shim"
_SHIM = "assets/worker_from_disk.js"
_WORKER_FROM_DISK = """\
// A worker in a hidden frame, for pages that were opened from disk.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      this.frame = document.createElement("iframe");
      this.frame.hidden = true;
      document.documentElement.append(this.frame);
      const inner = this.frame.contentWindow;
      inner.postMessage = data => this.dispatchEvent(new MessageEvent("message", {data}));
      this.loaded = new Promise(resolve => {
        const script = inner.document.createElement("script");
        script.onload = resolve;
        script.src = url;
        inner.document.head.append(script);
      });
    }
    postMessage(data) {
      this.loaded.then(() => {
        const inner = this.frame.contentWindow;
        inner.dispatchEvent(new inner.MessageEvent("message", {data}));
      });
    }
    terminate() {
      this.frame.remove();
    }
  };
}
"""
_LINK = re.compile(r"(?<=\]\()(\.\./[^)#\s]*)")


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Return the page with links outside ``docs/`` changed to the copies, and set its rank in the search."""
    if page.file.src_uri.startswith(("decisions/", "studies/", "licences.md")):
        page.meta["search"] = {"boost": 0.2}
    elif page.is_homepage:  # it answers common questions
        page.meta["search"] = {"boost": 3}
    elif page.file.src_uri == "reasons.md":  # the words of the screens
        page.meta["search"] = {"boost": 10}

    def copied(match: re.Match[str]) -> str:
        path = posixpath.normpath(posixpath.join("docs", posixpath.dirname(page.file.src_uri), match[0]))
        if path.startswith("docs/") or not (REPOSITORY / path).is_file():
            return match[0]
        name = f"repository/{path}" if not path.endswith(".md") else f"repository/{path}.txt"
        if name not in files.src_uris:
            files.append(File.generated(config, name, abs_src_path=str(REPOSITORY / path)))
        return posixpath.relpath(name, posixpath.dirname(page.file.src_uri) or ".")

    return _LINK.sub(copied, markdown)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the worker from disk to the files of the site."""
    files.append(File.generated(config, _SHIM, content=_WORKER_FROM_DISK))
    return files


def on_post_page(output: str, page: Page, config: MkDocsConfig) -> str:
    """Return the page with the worker from disk in place of the one from the network."""
    return output.replace(
        _NETWORK_SHIM, posixpath.relpath(_SHIM, posixpath.dirname(page.file.dest_uri) or ".")
    )
