"""Where the search begins, when it ends, and what it found."""

from dataclasses import dataclass

from ninedtact.force.traction.forward import Skin, Tractions
from ninedtact.force.traction.linearised import Linearised
from ninedtact.force.traction.pivoting import Lowest


@dataclass(frozen=True)
class Effort:
    """When the search ends."""

    rounds: int = 4
    """Of linearising, from a cold start."""
    warm_rounds: int = 1
    """The same where the last image's answer is at hand."""
    solves: int = 30
    """Of the quadratic, in each round."""
    enough: float = 1.0
    """Standard deviations of any sum of the unknowns by which an answer may be off for the search to end."""
    settled: float = 5.0
    """The same, for the answer to be believed."""


@dataclass(frozen=True)
class Explained:
    """The tractions that were found, over the shear modulus."""

    tractions: Tractions
    skin_mm: Skin
    """Height of all skin under them."""
    round: Linearised
    lowest: Lowest
    misfit: float
    """Root mean square of what is left, over its standard deviation; at least one."""
    off: float
    """How far from the optimum, at most: standard deviations of any sum of the unknowns."""
    rounds: int = 1


@dataclass(frozen=True)
class Guess:
    """Where to begin."""

    tractions: Tractions
    skin_mm: Skin
    misfit: float = 1.0
    rounds: int = 0
