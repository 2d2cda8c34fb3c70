"""Templates of pages: the one way in which HTML and Markdown files are filled in."""

from typing import Any


def load_template(package: str, template: str) -> Any:
    """Return a template that lies in a package; in one named *.html.jinja, texts are escaped.

    Filling it in raises `jinja2.UndefinedError` where it uses a value that is not given.
    """
    # Slow to import, and used only here.
    from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape

    pages = Environment(
        loader=PackageLoader(package, "."),
        autoescape=select_autoescape(["html.jinja"]),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return pages.get_template(template)


def render_page(package: str, template: str, **values: Any) -> str:
    """Return a template of `load_template`, filled in."""
    return str(load_template(package, template).render(**values))
