"""What is drawn in 3D: an object has the outline that it has."""

import numpy as np
import pytest

from ninedtact.simulation.objects.catalogue import indenter_from_name
from ninedtact.studio.scene_3d import OBJECT_HEIGHT_MM, indenter_underside_mesh


@pytest.mark.parametrize(
    ("name", "radius_mm"),
    [("punch:3", 3.0), ("ball:4", np.sqrt(4.0**2 - (4.0 - OBJECT_HEIGHT_MM) ** 2))],
)
def test_the_edge_of_a_round_object_is_a_circle(name: str, radius_mm: float) -> None:
    vertices, faces = indenter_underside_mesh(indenter_from_name(name))
    assert faces.max() < len(vertices)
    edge = vertices[vertices[:, 2] == OBJECT_HEIGHT_MM]
    assert len(edge) > 40
    distance_mm = np.hypot(edge[:, 0], edge[:, 1])
    assert distance_mm == pytest.approx(radius_mm, abs=0.15) and float(np.std(distance_mm)) < 0.06
