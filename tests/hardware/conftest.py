import pytest

from ninedtact.hardware.derived_design import DerivedDesign
from ninedtact.hardware.design import default_hardware_design, original_hardware_design


@pytest.fixture(scope="session")
def original() -> DerivedDesign:
    """The original's dimensions, built once."""
    return DerivedDesign(original_hardware_design())


@pytest.fixture(scope="session")
def default() -> DerivedDesign:
    """Ours."""
    return DerivedDesign(default_hardware_design())
