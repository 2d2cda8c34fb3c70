"""Check that the built documentation site works offline: pages load nothing from elsewhere, and every link within it has an end.

.venv/bin/python scripts/check_site.py out/site
"""

import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LOADING = {"script": "src", "link": "href", "img": "src", "iframe": "src", "source": "src", "video": "src"}
"""Elements that a browser loads without being asked, and the attribute that names what."""
NOT_LOADED = {"canonical", "next", "prev", "alternate"}


class PageReader(HTMLParser):
    """What a page loads, where it links to, and the places in it that can be linked to."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.loaded, self.links, self.anchors = set[str](), set[str](), set[str]()
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Take note of one element."""
        given = {name: value or "" for name, value in attrs}
        self.anchors |= {given["id"]} if "id" in given else set()
        target = given.get(LOADING.get(tag, ""), "")
        if target and given.get("rel") not in NOT_LOADED:
            self.loaded.add(target)
        if tag == "a" and given.get("href"):
            self.links.add(given["href"])


def find_faults(site: Path) -> list[str]:
    """Return a sentence for everything that a page loads from elsewhere, and for every link without an end."""
    pages = {page.resolve(): PageReader(page) for page in sorted(site.rglob("*.html"))}
    faults = [
        f"{sheet.relative_to(site)} loads {found}"
        for sheet in site.rglob("*.css")
        for found in re.findall(r"(?:url\(|@import )[\"']?(https?:[^)\"']+)", sheet.read_text(encoding="utf-8"))
    ]
    for path, page in pages.items():
        for target in sorted(page.loaded | page.links):
            parts = urlsplit(target)
            if parts.scheme in ("http", "https") or parts.netloc:
                if target in page.loaded:
                    faults.append(f"{path.name} loads {target}")
                continue
            if parts.scheme:
                continue
            base = site.resolve() if parts.path.startswith("/") else path.parent
            end = (base / unquote(parts.path).lstrip("/")).resolve() if parts.path else path
            end = end / "index.html" if end.is_dir() else end
            if not end.is_file():
                faults.append(f"{path.name} links to {target}, which does not exist")
            elif parts.fragment and end in pages and unquote(parts.fragment) not in pages[end].anchors:
                faults.append(f"{path.name} links to {target}, a place that does not exist")
    return faults


if __name__ == "__main__":
    found = find_faults(Path(sys.argv[1]))
    print("\n".join(found) or f"{sys.argv[1]}: pages load nothing from elsewhere, and all links within have an end")
    sys.exit(bool(found))
