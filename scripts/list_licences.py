"""List the licences of all installed libraries that the package may load at run time, with their versions.

Fails where a licence (GPL, AGPL) demands that programs which use the library take it over. Libraries for development and
documentation are left out, because no user loads them. Libraries that are not installed are named, because nothing is known about
them.
"""

import re
import sys
from importlib.metadata import Distribution, PackageNotFoundError, distribution

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PACKAGE = "ninedtact"
NOT_AT_RUN_TIME = ("dev", "docs")
UNSTATED = "not stated"
_COPYLEFT = re.compile(r"\bA?GPL|(?<!Lesser )(?<!Library )General Public License", re.IGNORECASE)
_EXCEPTION = re.compile(r"\S*GPL\S* WITH (GCC|Classpath)-exception\S*", re.IGNORECASE)
"""A licence of compilers' libraries that leaves the programs which use them free."""


def forbids_other_licences(licence: str) -> bool:
    """Return whether every alternative of a licence, as its package states it, demands that programs take it over."""
    alternatives = re.split(r"\s+OR\s+", _EXCEPTION.sub("", licence))
    return all(_COPYLEFT.search(alternative) for alternative in alternatives)


def stated_licence(package: Distribution) -> str:
    """Return the licence of a package in one line: its expression, else its classifiers, else the first line of its text."""
    metadata = package.metadata
    if expression := metadata.get("License-Expression"):
        return expression
    classifiers = [text for text in metadata.get_all("Classifier", []) if text.startswith("License ::")]
    names = [text.rpartition(" :: ")[2] for text in classifiers if text != "License :: OSI Approved"]
    return " AND ".join(names) or _first_line(metadata.get("License")) or _licence_file_title(package) or UNSTATED


def _licence_file_title(package: Distribution) -> str:
    """Return the first line of the licence file that a package brings; empty where it brings none."""
    files = [path for path in package.files or [] if re.match("licen[cs]e|copying", path.name, re.IGNORECASE)]
    return _first_line(files[0].read_text()) if files else ""


def _first_line(text: str | None) -> str:
    return (text or "").strip().partition("\n")[0].strip()


def run_time_libraries() -> dict[str, Distribution | None]:
    """Return everything that the package and its extras require, directly or not; None where it is not installed."""
    found: dict[str, Distribution | None] = {}
    extras = set(distribution(PACKAGE).metadata.get_all("Provides-Extra", [])) - set(NOT_AT_RUN_TIME)
    queue = [(PACKAGE, frozenset({"", *extras}))]
    seen = set()
    while queue:
        name, wanted = queue.pop()
        if (name, wanted) in seen:
            continue
        seen.add((name, wanted))
        try:
            package = distribution(name)
        except PackageNotFoundError:
            found[name] = None
            continue
        found[name] = package
        for requirement in map(Requirement, package.requires or []):
            if requirement.marker is None or any(requirement.marker.evaluate({"extra": extra}) for extra in wanted):
                queue.append((canonicalize_name(requirement.name), frozenset({"", *requirement.extras})))
    del found[PACKAGE]
    return dict(sorted(found.items()))


def main() -> int:
    """Print the table; return 1 where a licence does not fit."""
    libraries = run_time_libraries()
    refused = []
    for name, package in libraries.items():
        if package is not None:
            licence = stated_licence(package)
            print(f"{name:<28}{package.version:<16}{licence}")
            if forbids_other_licences(licence):
                refused.append(f"{name} ({licence})")
    if absent := [name for name, package in libraries.items() if package is None]:
        print(f"not installed, so not examined: {', '.join(absent)}")
    if refused:
        print(f"expected no GPL or AGPL at run time, got {', '.join(refused)}; replace it", file=sys.stderr)
    return 1 if refused else 0


if __name__ == "__main__":
    sys.exit(main())
