"""Version of the installed distribution, and of the libraries that its extras bring."""

from importlib.metadata import PackageNotFoundError, requires, version

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
