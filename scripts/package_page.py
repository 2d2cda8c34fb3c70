"""Build hook of hatchling: the page of the distribution is the README with links that work outside the repository.

The address of the repository comes from `NINEDTACT_REPOSITORY_URL`, which the release workflow sets to its own repository. Without
it links to files become plain text and images are left out, so that no page shows a broken link.
"""

import os
import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

REPOSITORY_URL = "NINEDTACT_REPOSITORY_URL"
_LINK = re.compile(r"(!?)\[([^\]]*)\]\((?!https?://|#)([^)\s]+)\)")


def package_page(readme: str, repository_url: str, version: str) -> str:
    """Return the README with absolute links to the files of a release, or without links where no address is known."""

    def absolute(link: re.Match[str]) -> str:
        image, text, path = link.groups()
        if not repository_url:
            return "" if image else text
        kind = "raw" if image else "blob"
        return f"{image}[{text}]({repository_url.rstrip('/')}/{kind}/v{version}/{path})"

    return _LINK.sub(absolute, readme)


class PackagePageHook(MetadataHookInterface):
    """Sets the fields `readme` and `urls` of the project."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Fill in what pyproject.toml names as dynamic."""
        url = os.environ.get(REPOSITORY_URL, "").rstrip("/")
        text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        page = package_page(text, url, metadata["version"])
        metadata["readme"] = {"content-type": "text/markdown", "text": page}
        links = {
            "Source": url,
            "Issues": f"{url}/issues",
            "Changelog": f"{url}/blob/v{metadata['version']}/CHANGELOG.md",
        }
        metadata["urls"] = links if url else {}
