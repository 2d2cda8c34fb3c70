"""`force.toml` in a sensor's folder: what its weighed presses said, one table for each estimator that they were read by."""

import tomllib
from pathlib import Path
from typing import Any

import msgspec
import tomli_w

from ninedtact.atomic_write import open_atomic_file
from ninedtact.errors import NinedtactError
from ninedtact.force.adaptation import Adaptation

FILE = "force.toml"


class AdaptationDamaged(NinedtactError):
    """A file of adaptations that cannot be understood."""


def read_adaptation(sensor: Path, estimator: str) -> Adaptation:
    """The adaptation of this sensor for this estimator; one that changes nothing where there is none.

    Raises `AdaptationDamaged`.
    """
    return tables(sensor).get(estimator, Adaptation())


def write_adaptation(sensor: Path, estimator: str, adaptation: Adaptation) -> Path:
    """Add or replace one estimator's table; raises `AdaptationDamaged`, `FileNotWritten`."""
    found = {**tables(sensor), estimator: adaptation}
    plain: dict[str, Any] = {name: msgspec.to_builtins(one) for name, one in found.items()}
    with open_atomic_file(sensor / FILE) as file:
        tomli_w.dump(plain, file)
    return sensor / FILE


def tables(sensor: Path) -> dict[str, Adaptation]:
    """Every table of the file; none where there is no file."""
    path = sensor / FILE
    if not path.exists():
        return {}
    try:
        return msgspec.convert(tomllib.loads(path.read_text(encoding="utf-8")), dict[str, Adaptation])
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, msgspec.ValidationError) as trouble:
        raise AdaptationDamaged(
            f"expected {path} as 'ninedtact adapt' wrote it, got: {trouble}; delete it and adapt again"
        ) from trouble
