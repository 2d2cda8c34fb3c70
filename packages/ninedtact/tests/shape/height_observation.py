"""An observation model for tests of force without light: the reading's height map is the change of the gel's thickness."""

from dataclasses import dataclass

import numpy as np

from ninedtact.force.contact_detection import estimate_cell_noise
from ninedtact.force.traction.observation import (
    BrightnessLaw,
    CellGrid,
    ObservationModel,
    ObservationOnCells,
    orthorectify_onto_cells,
)
from ninedtact.reading import Reading

_AS_IT_IS = BrightnessLaw(np.array([-20.0, -10.0, 20.0]), np.array([-20.0, -10.0, 20.0]))
_MIN_NOISE_MM = 0.002


@dataclass(frozen=True)
class HeightObservationModel(ObservationModel):
    """Observes the height map alone; the gel lies on a rigid base, or the map is that of the gel's thickness."""

    error_mm: float = 0.01
    law: BrightnessLaw = _AS_IT_IS
    point_spread_mm: float = 0.0

    def observe(self, reading: Reading, cells: CellGrid) -> ObservationOnCells:
        """Return the reading's heights on the cells."""
        below, _ = orthorectify_onto_cells(reading.height, cells)
        noise = max(estimate_cell_noise(below.z_mm), _MIN_NOISE_MM)
        in_view = below.in_view.astype(np.float32)
        return ObservationOnCells(below.z_mm, noise, self.error_mm, below.z_mm, in_view)
