"""Hook of MkDocs (mkdocs.yml): on the site, the links to source files in docs/api.md become the docstrings of what they name.

On a code host the same links open the files.
"""

import re
from typing import Any

LINK = re.compile(r"\[`(\w+)`\]\(\.\./packages/[\w-]+/src/([\w/]+)\.py\)")


def documented_names(markdown: str) -> list[str]:
    """Return the dotted names that a page documents: what is linked, or the module itself where it is named."""
    found = [(name, path.replace("/", ".")) for name, path in LINK.findall(markdown)]
    return [module if module.endswith(f".{name}") else f"{module}.{name}" for name, module in found]


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Return a page with a directive of mkdocstrings in place of every link of a line that begins with "Reference:"."""
    return re.sub(
        r"^Reference: .*?(?=\n\n|\n*\Z)",
        lambda paragraph: "\n".join(f"::: {name}\n" for name in documented_names(paragraph[0])),
        markdown,
        flags=re.DOTALL | re.MULTILINE,
    )
