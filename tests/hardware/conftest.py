import pytest

from ninedtact.hardware.complete_design import CompleteDesign
from ninedtact.hardware.design import default_hardware_design, original_hardware_design


@pytest.fixture(scope="session")
def original() -> CompleteDesign:
    """The original's dimensions, built once."""
    return CompleteDesign(original_hardware_design())


@pytest.fixture(scope="session")
def default() -> CompleteDesign:
    """Ours."""
    return CompleteDesign(default_hardware_design())
