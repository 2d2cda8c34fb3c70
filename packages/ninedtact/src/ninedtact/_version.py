"""Version of the installed distribution, and of the libraries that its extras bring."""

from importlib.metadata import EntryPoint, PackageNotFoundError, entry_points, requires, version
from pathlib import Path

__version__ = version("ninedtact")


def find_incompatible_library(extra: str) -> str:
    """Describe the first installed library of an extra whose version ninedtact does not declare; empty where all are right.

    "expected cyclonedds>=11,<12, got 0.10.5", for the sentence of an error.
    """
    from packaging.requirements import Requirement

    for requirement in map(Requirement, requires("ninedtact") or ()):
        if requirement.marker is None or not requirement.marker.evaluate({"extra": extra}):
            continue
        try:
            installed = version(requirement.name)
        except PackageNotFoundError:
            continue
        if not requirement.specifier.contains(installed, prereleases=True):
            return f"expected {requirement.name}{requirement.specifier}, got {installed}"
    return ""


SIBLINGS = {
    "datasets": "ninedtact-train",
    "train": "ninedtact-train[training]",
    "environments": "ninedtact-train[environments]",
    "hardware": "ninedtact-hardware",
}
"""Extras that install another distribution of the repository, which in a checkout is installed from its own folder."""


def find_entry_point(group: str, name: str) -> EntryPoint | None:
    """Return what an installed distribution offers under a name of the group `ninedtact.GROUP`, not yet imported, or None."""
    return next(iter(entry_points(group=f"ninedtact.{group}", name=name)), None)


def installation_command(extras: str) -> str:
    """Return the command that installs extras, such as "train,studio": from the folders of a checkout, or by the name on PyPI."""
    package = Path(__file__).parents[2]
    if not (package / "pyproject.toml").is_file():  # no checkout of the repository
        return f"pip install 'ninedtact[{extras}]'"
    own = ",".join(extra for extra in extras.split(",") if extra not in SIBLINGS)
    folders = [f"{package}[{own}]" if own else str(package)]
    folders += [str(package.parent / SIBLINGS[extra]) for extra in extras.split(",") if extra in SIBLINGS]
    return "pip install " + " ".join(f"-e '{folder}'" for folder in folders)
