import pytest

from ninedtact.hardware.design import default_hardware, original_hardware
from ninedtact.hardware.report import BuiltSensor


@pytest.fixture(scope="session")
def original() -> BuiltSensor:
    """The original's dimensions, built once."""
    return BuiltSensor(original_hardware())


@pytest.fixture(scope="session")
def default() -> BuiltSensor:
    """Ours."""
    return BuiltSensor(default_hardware())
