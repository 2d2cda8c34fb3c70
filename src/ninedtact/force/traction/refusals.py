"""What force without training cannot be asked."""

from ninedtact.design import Gel
from ninedtact.errors import NinedtactError


class TractionImpossible(NinedtactError):
    """A sensor or a reading out of which no traction can be read."""


def require_bulges(knows_bulges: bool) -> None:
    """Refuse a depth curve without its bright half: shear shows in the bulges alone."""
    if not knows_bulges:
        raise TractionImpossible(
            "expected a depth curve that knows bulges, got one for indentation alone; calibrate with the method 'physics'"
        )


def require_view(seen: bool) -> None:
    """Refuse a reading of which nothing is in view."""
    if not seen:
        raise TractionImpossible(
            "expected a height map with pixels in view, got one that is out of view everywhere; calibrate the board again"
        )


def required_gel(gel: Gel | None) -> Gel:
    """Refuse to read forces without a gel."""
    if gel is None:
        raise TractionImpossible(
            "expected the gel's thickness and shear modulus, got no gel; give SensorDesign().gel, or the gel of the sensor's twin"
        )
    return gel
