"""Look for anything that a browser would fetch from another host, or not find: ``check_pages.py FOLDER``.

Links to click on may lead anywhere; scripts, styles, images, fonts, frames and the like must lie in the
folder, or the pages do not open from disk without a network.

``check_pages.py --sentences PAGE.md ...`` prints sentences of more than 35 words.

``check_pages.py --versions SITE`` writes the list of the versions in a folder, ``versions.js``, and
``index.html``, which leads to the newest.  Each version has a folder of its own; its pages read the list when
they are opened: older versions know newer ones.  It works from disk, too.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

_LARGEST = 400_000  # bytes of a page: what nobody reads to its end; reports hold their figures themselves
_TEMPLATES = {"webpack-macros.html"}  # the theme leaves it beside its styles; no page refers to it
# What a browser loads by itself. A link is loaded if its rel says so.
_LOADED = {
    "script": ("src",),
    "img": ("src", "srcset"),
    "source": ("src", "srcset"),
    "iframe": ("src",),
    "embed": ("src",),
    "object": ("data",),
    "video": ("src", "poster"),
    "audio": ("src",),
    "track": ("src",),
    "input": ("src",),
    "image": ("href", "xlink:href"),
    "use": ("href", "xlink:href"),
}
_LOADING_RELATIONS = {
    "stylesheet",
    "icon",
    "shortcut",
    "apple-touch-icon",
    "preload",
    "modulepreload",
    "prefetch",
    "preconnect",
    "dns-prefetch",
    "manifest",
}
_CSS = re.compile(r"""url\(\s*["']?([^"')]+)|@import\s+["']([^"']+)""")
# Scripts: calls that load from an address written out in full.
_HOST = r"""["'`](?:https?:)?//[\w.-]+\.[a-z]{2,}"""
_CALLS = re.compile(
    r"(?:fetch|import|importScripts|sendBeacon|EventSource|WebSocket|Worker)\(\s*" + _HOST
    + r"|\.open\(\s*[\"'`][A-Z]+[\"'`]\s*,\s*" + _HOST
    + r"|\.(?:src|href)\s*=\s*" + _HOST
    + r"|(?:from|import)\s*" + _HOST
)  # fmt: skip


class _Page(HTMLParser):
    """Collects what one page loads, and its inner links."""

    def __init__(self) -> None:
        super().__init__()
        self.loaded: list[str] = []
        self.links: list[str] = []
        self.scripts: list[str] = []
        self.styles: list[str] = []
        self._inside = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {name: value or "" for name, value in attrs}
        for name in _LOADED.get(tag, ()):
            if name in values:
                self.loaded += _sources(values[name]) if name == "srcset" else [values[name]]
        if tag == "link" and set(values.get("rel", "").lower().split()) & _LOADING_RELATIONS:
            self.loaded.append(values.get("href", ""))
        if tag == "meta" and values.get("http-equiv", "").lower() == "refresh":
            self.loaded.append(values.get("content", "").partition("url=")[2])
        if tag == "a" and "href" in values:
            self.links.append(values["href"])
        if "style" in values:
            self.styles.append(values["style"])
        self._inside = tag

    def handle_endtag(self, tag: str) -> None:
        self._inside = ""

    def handle_data(self, data: str) -> None:
        if self._inside == "script":
            self.scripts.append(data)
        elif self._inside == "style":
            self.styles.append(data)


def _sources(srcset: str) -> list[str]:
    return [part.split()[0] for part in srcset.split(",") if part.split()]


def _is_foreign(address: str) -> bool:
    parts = urlsplit(address.strip())
    return bool(parts.netloc) or parts.scheme in {"http", "https", "ftp", "ws", "wss"}


def _is_missing(address: str, page: Path) -> bool:
    """Whether a relative address leads to no file."""
    parts = urlsplit(address.strip())
    if parts.scheme or parts.netloc or not parts.path:
        return False
    return parts.path.startswith("/") or not (page.parent / unquote(parts.path)).exists()


def check_page(text: str, page: Path) -> Iterator[str]:
    """Yield what is wrong with one HTML page."""
    parser = _Page()
    parser.feed(text)
    parser.close()
    styles = [a or b for style in parser.styles for a, b in _CSS.findall(style)]
    for address in (*parser.loaded, *styles):
        if _is_foreign(address):
            yield f"loads {address}"
        elif _is_missing(address, page):
            yield f"loads {address}, which is not there"
    for address in parser.links:
        if not _is_foreign(address) and _is_missing(address, page):
            yield f"links to {address}, which is not there"
    for script in parser.scripts:
        yield from (f"has a script that loads {call}" for call in _CALLS.findall(script))


def check_style(text: str, path: Path) -> Iterator[str]:
    """Yield what is wrong with a style sheet."""
    for quoted, imported in _CSS.findall(re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)):
        address = quoted or imported
        if _is_foreign(address):
            yield f"loads {address}"
        elif not address.startswith(("data:", "#")) and _is_missing(address, path):
            yield f"loads {address}, which is not there"


def check_script(text: str, path: Path) -> Iterator[str]:
    """Yield what is wrong with a script."""
    yield from (f"loads {call}" for call in _CALLS.findall(text))


# Markdown that is no prose: front matter, code, comments, images, tables' rules.
_NO_PROSE = re.compile(
    r"\A---\n.*?^---$|^(`{3,}|:{3,}).*?$|^(?: {4}.*\n)+|<!--.*?-->|!\[[^\]]*\]\([^)]*\)|^\|[-| ]+\|$",
    re.M | re.S,
)
_FENCED = re.compile(r"^(`{3,}).*?^\1$|^\$\$$.*?^\$\$$", re.M | re.S)
_PARAGRAPH_ENDS = re.compile(r"\n\s*\n|\n(?=\s*(?:[*+-]|\d+\.|#|>)\s)|\n(?=\|)|\|")
_SENTENCE_ENDS = re.compile(r"(?<=[.!?])[*)\"”]*\s+(?=[*(\"“]*[A-Z0-9θ`$\[])")


def sentences(text: str) -> Iterator[str]:
    """Yield the sentences of a page in Markdown; a formula, a name in code or a cell is one word or more."""
    text = _NO_PROSE.sub("\n\n", _FENCED.sub("\n\n", text))
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", lambda link: link[1] or "Page", text)
    text = re.sub(r"`[^`\n]+`|\$[^$\n]+\$", "Code", text)
    for paragraph in _PARAGRAPH_ENDS.split(text):
        yield from (" ".join(part.split()) for part in _SENTENCE_ENDS.split(paragraph) if part.strip())


def long_sentences(text: str, most: int = 35) -> Iterator[tuple[int, str]]:
    """Yield sentences of more words than that, with their number of words."""
    for sentence in sentences(text):
        words = sum(any(letter.isalnum() for letter in word) for word in sentence.split())
        if words > most:
            yield words, sentence


_CHECKS = {".html": check_page, ".css": check_style, ".js": check_script, ".mjs": check_script}


def problems(folder: Path) -> Iterator[str]:
    """Yield one line for each thing that is wrong in a folder of built pages."""
    for path in sorted(folder.rglob("*")):
        check = _CHECKS.get(path.suffix)
        if check and path.is_file() and path.name not in _TEMPLATES:
            for problem in check(path.read_text(encoding="utf-8", errors="replace"), path):
                yield f"{path.relative_to(folder)}: {problem}"
            size = path.stat().st_size
            if path.suffix == ".html" and size > _LARGEST:
                yield f"{path.relative_to(folder)}: has {size} bytes, more than {_LARGEST}"


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


def main(arguments: list[str]) -> int:
    """Print problems of a folder or long sentences of pages, return 1 if there is one; or list versions."""
    if arguments[0] == "--sentences":
        texts = {name: Path(name).read_text(encoding="utf-8") for name in arguments[1:]}
        long = [f"{name}: {n} words: {s}" for name, text in texts.items() for n, s in long_sentences(text)]
        print("\n".join(long) if long else "no sentence of more than 35 words")
        return 1 if long else 0
    if arguments[0] == "--versions":
        print("versions:", *write_list(Path(arguments[1])))
        return 0
    folder = Path(arguments[0])
    if not (folder / "index.html").exists():
        print(f"error: no pages in {folder}; build them with make docs", file=sys.stderr)
        return 2
    found = list(problems(folder))
    print("\n".join(found) if found else f"{folder}: nothing is loaded from elsewhere, nothing is missing")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
