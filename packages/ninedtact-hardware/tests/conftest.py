import pytest

from ninedtact_hardware.buildable_design import BuildableDesign
from ninedtact_hardware.design import HardwareDesign, original_hardware_design


@pytest.fixture(scope="session")
def original() -> BuildableDesign:
    """The original's dimensions, built once."""
    return BuildableDesign(original_hardware_design())


@pytest.fixture(scope="session")
def default() -> BuildableDesign:
    """Ours."""
    return BuildableDesign(HardwareDesign())
