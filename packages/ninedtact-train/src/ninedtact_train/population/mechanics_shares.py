"""The kinds of mechanics that simulated sensors have, and the share of each."""

from dataclasses import dataclass
from typing import Literal

from ninedtact.errors import InputError

MechanicsKind = Literal["bonded", "compliant_base", "finite_strain"]


@dataclass(frozen=True)
class NonidealMechanicsShares:
    """Shares of sensors whose mechanics differ from the gel on a rigid base that estimators assume."""

    compliant_base: float = 0.15
    """Share of sensors whose gel lies on a compliant substrate."""
    finite_strain: float = 0.55
    """Share of sensors with a finite-strain gel, which stiffens as it thins."""

    def __post_init__(self) -> None:
        if not (min(self.compliant_base, self.finite_strain) >= 0 and self.compliant_base + self.finite_strain <= 1):
            raise InputError(
                expected="shares of sensors from 0 to 1, together at most 1",
                got=f"{self.compliant_base} on a compliant base and {self.finite_strain} with finite strain",
                remedy="correct them",
            )

    def kind_at(self, quantile: float) -> MechanicsKind:
        """Return the kind at a quantile, 0 to 1."""
        if quantile < self.compliant_base:
            return "compliant_base"
        return "finite_strain" if quantile < self.compliant_base + self.finite_strain else "bonded"
