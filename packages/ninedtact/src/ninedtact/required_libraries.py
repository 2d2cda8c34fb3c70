"""The check that the libraries of an extra are installed: what needs them is refused in one sentence without them."""

from importlib.util import find_spec

from ninedtact._version import find_incompatible_library, installation_command
from ninedtact.errors import MissingLibraryError


def require_libraries(extra: str, *modules: str) -> None:
    """Raise `MissingLibraryError` where modules of an extra are missing, or its libraries have versions that are not declared."""
    absent = [name for name in modules if find_spec(name) is None]
    remedy = f"run {installation_command(extra)}"
    if absent:
        raise MissingLibraryError(
            expected=f"{' and '.join(modules)}, which this needs", got=f"no {' and no '.join(absent)}", remedy=remedy
        )
    if other := find_incompatible_library(extra):
        raise MissingLibraryError(f"{other}; {remedy}")
