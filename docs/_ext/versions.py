"""Documentation in several versions: one folder a version, and a menu in the bar that leads to the others.

``make docs-site`` builds the pages of this version into ``site/<version>`` and runs this file, which writes
``site/versions.js``, the list of all versions there, and ``site/index.html``, which leads to the newest. The
pages read the list when they are opened: older versions know newer ones. It works from disk, too.
"""

from __future__ import annotations

import json
import os
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sphinx.application import Sphinx

_MENU = """
(() => {
  const root = document.documentElement.dataset.content_root || "./";
  const list = document.createElement("script");
  list.src = root + "../versions.js";
  list.onload = () => {
    const menu = document.createElement("select");
    menu.setAttribute("aria-label", "Version of the documentation");
    menu.className = "form-select form-select-sm w-auto";
    for (const version of window.documentedVersions) {
      menu.add(new Option(version, version, false, version === "%s"));
    }
    menu.onchange = () => { location.href = root + "../" + menu.value + "/index.html"; };
    document.querySelector(".navbar-header-items__end")?.prepend(menu);
  };
  document.head.append(list);
})();
"""


def by_age(name: str) -> tuple[list[int], bool, str]:
    """Sort key: numbers by value; a release is newer than its own previews."""
    release = re.match(r"\d+(?:\.\d+)*", name)
    numbers = [int(part) for part in release[0].split(".")] if release else []
    return numbers, bool(re.fullmatch(r"[\d.]+", name)), name


def write_list(site: Path) -> list[str]:
    """Write the list of the versions in a folder, newest first, and the page that leads to the newest."""
    found = [page.parent.name for page in site.glob("*/index.html")]
    names = sorted(found, key=by_age, reverse=True)
    (site / "versions.js").write_text(f"window.documentedVersions = {json.dumps(names)};\n", encoding="utf-8")
    newest = f'<meta http-equiv="refresh" content="0; url={names[0]}/index.html">' if names else ""
    head = f'<html lang="en"><head><meta charset="utf-8"><title>leastaction</title>{newest}</head>'
    links = "".join(f'<li><a href="{name}/index.html">{name}</a></li>' for name in names)
    (site / "index.html").write_text(
        f"<!doctype html>{head}<body><ul>{links}</ul></body></html>\n", encoding="utf-8"
    )
    return names


def setup(app: Sphinx) -> dict[str, object]:
    """Add the menu, where the pages will lie beside those of other versions."""
    if os.environ.get("DOCS_SITE"):
        app.add_js_file(None, body=_MENU % app.config.version)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}


if __name__ == "__main__":
    print("versions:", *write_list(Path(sys.argv[1])))
