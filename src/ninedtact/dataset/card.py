"""What a person reads of a data set that was built, and Hugging Face too."""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from ninedtact.dataset.report import REPORT, Report
from ninedtact.dataset.rows import writable
from ninedtact.dataset.sources.source import Source
from ninedtact.dataset.sources.table import NO_OBJECT
from ninedtact.errors import NinedtactError

LICENCE = re.compile(r"[A-Za-z0-9][A-Za-z0-9.+-]*")
COLUMNS = """\
| column | what |
|---|---|
| image | the rectified sensor image, grey |
| reference | id of the image of the untouched skin, in config `references` |
| wrench | Fx Fy Fz in N, Tx Ty Tz in N·m, of the object on the skin: pressing gives Fz < 0 |
| object | what touches; `none` where nothing does |
| contact | rows that share it are of one continuous contact; splits should keep them together |
| step, time_ns | within the contact or session; time of the image, where it is known |
| sensor | which one |
| kind | `rule`: kept by the paper's rule for collecting; `light_touch`; `no_contact`; `stream`: every image of an episode |
| id | unlike all others |
| source | where the pair came from |
| mm_per_px | scale of the image, where it is known |
| gap_ms | from image to wrench, where both have a time |"""


class LicenceImpossible(NinedtactError):
    """Something that is no name of a licence."""


@dataclass(frozen=True)
class Contents:
    """What is in a data set, counted."""

    kinds: Mapping[str, int]
    sensors: Mapping[str, int]
    objects: Mapping[str, int]
    percentiles: Iterable[str]

    @property
    def pairs(self) -> int:
        """All of them."""
        return sum(self.kinds.values())

    @property
    def things(self) -> int:
        """How many objects, no object not being one."""
        return len(set(self.objects) - {NO_OBJECT})


def require_licence(licence: str | None) -> None:
    """Refuse a sentence where a name is wanted; raises `LicenceImpossible`."""
    if licence is not None and not LICENCE.fullmatch(licence):
        raise LicenceImpossible(
            f"expected a licence as Hugging Face names it, such as mit or cc-by-nc-4.0, got {licence!r}; correct it"
        )


def card(contents: Contents, sources: Iterable[Source], licence: str | None, report: Report, version: str) -> str:
    """The whole text."""
    sources = list(sources)
    counted = ", ".join(f"{count} {kind}" for kind, count in contents.kinds.items())
    return "\n".join(
        [
            *head(licence),
            "# Images and wrenches of 9DTact sensors",
            "",
            f"Built by `ninedtact dataset build` {version}: {contents.pairs} pairs ({counted}) of {len(contents.sensors)} "
            f"sensors and {contents.things} objects.",
            "Licence: " + (licence or "not stated; ask whoever made the sources before handing the data on."),
            "",
            COLUMNS,
            "",
            "Torques are about the centre of the untouched skin. Sensor frame: x along columns, y along rows, z outward "
            "through the skin.",
            "",
            "## Sources",
            "",
            *(line for source in sources for line in lines_of(source)),
            "",
            *(part for source in sources for warning in source.warnings for part in (warning, "")),
            "## Checks",
            "",
            *(f"    {line}" for line in report.lines()),
            "",
            f"`{REPORT}` lists each. No pair goes unlisted.",
            "",
            "## Percentiles",
            "",
            *(f"    {line}".rstrip() for line in contents.percentiles),
            "",
        ]
    )


def head(licence: str | None) -> Iterator[str]:
    """What Hugging Face reads."""
    yield from ("---", "pretty_name: 9DTact, images and wrenches")
    if licence:
        yield f"license: {licence.lower()}"
    yield from ("tags: [tactile-sensing, robotics]", "configs:")
    for name, path in (("default", "data/train-*.parquet"), ("references", "references.parquet")):
        yield from (f"- config_name: {name}", "  data_files:", "  - split: train", f"    path: {path}")
    yield from ("---", "")


def lines_of(source: Source) -> Iterator[str]:
    """One source, and what a person stated about it."""
    yield f"- `{source.name}`: {source.what}, from `{writable(source.path.resolve().name)}`"
    yield from (f"  - {said}" for said in source.said())
