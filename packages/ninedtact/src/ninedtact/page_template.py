"""Templates of pages: the one way in which HTML and Markdown files are filled in."""

from typing import Any


def render_page(package: str, template: str, **values: Any) -> str:
    """Return a template that lies in a package, filled in; in one named *.html.jinja, texts are escaped.

    Raises `jinja2.UndefinedError` where the template uses a value that is not given.
    """
    from jinja2 import (
        Environment,
        PackageLoader,
        StrictUndefined,
        select_autoescape,
    )  # slow to import, and used only here

    pages = Environment(
        loader=PackageLoader(package, "."),
        autoescape=select_autoescape(["html.jinja"]),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return pages.get_template(template).render(**values)
