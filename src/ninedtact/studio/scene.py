"""The 3D part of the page: the skin true to scale on its block of gel, and what presses it."""

import numpy as np
from viser import LabelHandle, LineSegmentsHandle, MeshHandle, PointCloudHandle, ViserServer

from ninedtact.quantities import Wrench
from ninedtact.studio.arrows import Arrows
from ninedtact.studio.ruler import Block
from ninedtact.studio.studio import Look
from ninedtact.studio.surface import LIGHT, Surface

GEL, PAST = (150, 172, 196), (110, 114, 118)
"""Colours of the skin as a surface: silicone, and silicone that was."""
EDGES, FLOOR = (120, 128, 138), (205, 210, 216)
FIELD_OF_VIEW_RAD = 0.72
POINT_OVERLAP = 1.3
"""Points are drawn this much larger than their spacing, so that the skin has no gaps where it is steep."""


class Scene:
    """Draws the skin in a viser server."""

    def __init__(self, server: ViserServer, block: Block) -> None:
        place_camera(server, block)
        light(server)
        empty, level = np.zeros((1, 3), np.float32), np.zeros((1, 3), np.uint32)
        self._mesh: MeshHandle = server.scene.add_mesh_simple("/skin/surface", empty, level, color=GEL, side="double")
        self._points: PointCloudHandle = server.scene.add_point_cloud(
            "/skin/points", empty, GEL, point_shape="square", point_shading="flat"
        )
        self._lines = [
            server.scene.add_line_segments(f"/gel/{name}", lines, colour, thickness=1.5, thickness_units="screen")
            for name, lines, colour in (("floor", block.floor_mm, FLOOR), ("edges", block.edges_mm, EDGES))
        ]
        self._marks = [(mark, mark_on(server, number, mark.text)) for number, mark in enumerate(block.marks())]
        self._arrows = Arrows(server, "wrench")
        self._stretch(1.0)

    def push(self, wrench: Wrench | None) -> None:
        """Draw what presses the skin; heights may be stretched, forces are not."""
        self._arrows.show(wrench)

    def show(self, surface: Surface, look: Look, is_past: bool) -> None:
        """Draw one surface."""
        if look.as_points:
            self._points.points, self._points.colors = surface.points_mm, surface.colours
            self._points.point_size = surface.spacing_mm * POINT_OVERLAP / np.cbrt(look.exaggeration)
        else:
            self._mesh.vertices, self._mesh.faces = surface.points_mm, surface.faces.astype(np.uint32)
            self._mesh.color = PAST if is_past else GEL
        self._points.visible, self._mesh.visible = look.as_points, not look.as_points
        self._stretch(look.exaggeration)

    def _stretch(self, exaggeration: float) -> None:
        stretched: list[MeshHandle | PointCloudHandle | LineSegmentsHandle] = [self._mesh, self._points, *self._lines]
        for node in stretched:
            node.scale = (1.0, 1.0, exaggeration)
        for mark, label in self._marks:
            x, y, z = mark.at_mm
            label.position = (x, y, z * exaggeration)


def place_camera(server: ViserServer, block: Block) -> None:
    """Look at the skin from the front and above, x to the right."""
    far = max(block.width_mm, block.length_mm)
    server.scene.set_up_direction("+z")
    server.initial_camera.position = (0.0, -1.7 * far, 1.4 * far)
    server.initial_camera.look_at = (0.0, -0.05 * far, -block.gel_mm)
    server.initial_camera.fov = FIELD_OF_VIEW_RAD
    server.initial_camera.near, server.initial_camera.far = 0.1, 100 * far


def light(server: ViserServer) -> None:
    """One light from where the points are lit from; the rest is soft, without cast shadows."""
    server.scene.configure_default_lights(enabled=False, cast_shadow=False)
    server.scene.configure_environment_map(hdri=None)
    server.scene.add_light_ambient("/light/soft", intensity=1.1)
    server.scene.add_light_directional("/light/grazing", position=tuple(20 * LIGHT.astype(float)), intensity=2.2)


def mark_on(server: ViserServer, number: int, text: str) -> LabelHandle:
    """One text at an edge."""
    return server.scene.add_label(f"/gel/mark_{number}", text, font_screen_scale=0.8, anchor="center-center")
