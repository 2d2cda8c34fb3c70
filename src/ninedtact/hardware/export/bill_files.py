"""The bill of materials as CSV and as a page."""

import csv
from collections.abc import Sequence
from io import StringIO

from ninedtact.hardware.bom import Item, cost_usd
from ninedtact.hardware.design import HardwareDesign

HEADINGS = "kind", "name", "count", "what", "each_usd_estimated"


def bill_csv(items: Sequence[Item]) -> bytes:
    """One line per item."""
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(HEADINGS)
    writer.writerows((item.kind, item.name, item.count, item.what, f"{item.each_usd:.2f}") for item in items)
    return text.getvalue().encode()


def bill_html(design: HardwareDesign, items: Sequence[Item]) -> bytes:
    """A page that loads nothing but the images beside it."""
    # jinja2 is slow to import, and only this function needs it.
    from jinja2 import Environment, PackageLoader, StrictUndefined

    pages = Environment(
        loader=PackageLoader("ninedtact.hardware.export", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page = pages.get_template("bill.html.jinja")
    return page.render(design=design, items=items, total=cost_usd(list(items))).encode()
