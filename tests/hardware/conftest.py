import pytest

from ninedtact.hardware.built_sensor import BuiltSensor
from ninedtact.hardware.design import default_hardware_design, original_hardware_design


@pytest.fixture(scope="session")
def original() -> BuiltSensor:
    """The original's dimensions, built once."""
    return BuiltSensor(original_hardware_design())


@pytest.fixture(scope="session")
def default() -> BuiltSensor:
    """Ours."""
    return BuiltSensor(default_hardware_design())
