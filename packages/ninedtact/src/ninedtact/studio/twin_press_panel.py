"""The panel that presses a twin by hand: the choice of objects, sliders, the 3D handle, one's own mesh, and the press sequence.

Every viewer has these controls; they move one object, so each follows what the others do.
"""

from collections.abc import Sequence
from functools import partial
from threading import Lock
from typing import Any

import numpy as np
from viser import GuiApi, GuiEvent, GuiUploadButtonHandle, Icon, TransformControlsEvent, UploadedFile
from viser.transforms import SO3

from ninedtact.mechanics.pose import Pose
from ninedtact.simulation.objects.mesh_objects import MM_PER_UNIT, MeshPlacement
from ninedtact.studio.page_cards import card_html
from ninedtact.studio.page_controller import PageMoment, SensorMoment
from ninedtact.studio.press_control import (
    FIT,
    FIT_MM,
    MAX_NUMBER,
    OBJECTS_BY_KIND,
    OWN_KIND,
    UPLOAD_SUFFIXES,
    HandPressState,
    TwinPressController,
    pose_fields,
)
from ninedtact.studio.viewer import ControlFollower, Side, ViewerPage, on_user_change

HANDLE_LIFT_MM = 7.0
"""Height of the 3D handle over the lowest point of the object, so that both can be seen."""
_HANDLE_SCALE = 4.0
_LEAST_QUATERNION = 1e-3
"""Length of a quaternion, of which browsers send 1, below which its direction is not meaningful."""
_SIDES = {
    "bottom (−z)": "-z",
    "top (+z)": "+z",
    "left (−x)": "-x",
    "right (+x)": "+x",
    "front (−y)": "-y",
    "back (+y)": "+y",
}
"""The sides of a mesh, as the page names them."""
_SEQUENCE, _BY_DEPTH, _BY_LOAD = "sequence plays", "to a depth", "under a load"
_SLIDERS = {
    "depth (mm)": 0.05,
    "load (N)": 0.1,
    "drag x (mm)": 0.1,
    "drag y (mm)": 0.1,
    "twist (°)": 1.0,
    "tilt about x (°)": 0.5,
    "tilt about y (°)": 0.5,
}

"""The sliders, in the order of the limits of `TwinPressController`, with their steps."""
_NOT_PRESSED = "A recording is shown. To press the twin, go back to the sensor in the tab Record."


class TwinPressPanel:
    """Presses the twin by hand."""

    title, icon = "Press", Icon.HAND_FINGER
    side: Side = "right"

    def __init__(self, viewer: ViewerPage, controls: Sequence[TwinPressController]) -> None:
        """controls: one for each sensor of the page."""
        self._viewer, self._controls = viewer, tuple(controls)
        self._followed, self._follower = (-1, -1), ControlFollower()
        self._is_dragged, self._dragged_to = False, dict[str, float]()
        self._noting, self._moving = Lock(), Lock()

    @property
    def _pressed(self) -> tuple[TwinPressController, ...]:
        """The twins that are pressed: those that the views show, in the same way, as the fingers of a gripper close."""
        number = self._viewer.options.sensor
        return self._controls if number is None else (self._controls[number],)

    @property
    def _control(self) -> TwinPressController:
        """The twin that the controls follow: the first of those that are pressed."""
        return self._pressed[0]

    def build(self, gui: GuiApi) -> None:
        """Add the choice of objects, the sliders and the 3D handle."""
        state, limits = self._control.state, self._control.limits
        self._says = gui.add_html("")
        self._mode = gui.add_dropdown("press", (_SEQUENCE, _BY_DEPTH, _BY_LOAD), initial_value=_mode_of(state))
        self._kind = gui.add_dropdown("kind", (*OBJECTS_BY_KIND, OWN_KIND), initial_value=state.kind)
        self._family = gui.add_dropdown("object", self._names_of_kind(state.kind), initial_value=state.family)
        self._number = gui.add_slider("number", 1, MAX_NUMBER, 1, state.number, hint="number within the family")
        self._sliders = {
            name: gui.add_slider(label, low, high, step, getattr(state, name))
            for (name, (low, high)), (label, step) in zip(limits.items(), _SLIDERS.items(), strict=True)
        }
        self._own_mesh = gui.add_folder("own mesh (STL, OBJ)", expand_by_default=False)
        with self._own_mesh:
            self._unit = gui.add_dropdown("unit", (FIT, *MM_PER_UNIT), initial_value="mm")
            self._side = gui.add_dropdown("side that faces the skin", tuple(_SIDES))
            upload = gui.add_upload_button("Upload a mesh", icon=Icon.UPLOAD, mime_type=",".join(UPLOAD_SUFFIXES))
        on_user_change(self._mode, self._choose_mode)
        for chooser in (self._kind, self._family, self._number):
            on_user_change(chooser, self._choose_object)
        for name, slider in self._sliders.items():
            on_user_change(slider, partial(self._move, name))
        upload.on_upload(self._upload)
        self._add_handle()
        self._follow(state)

    def update(self, moment: PageMoment) -> None:
        """Follow what other viewers do, and say how the contact is; a recording is not pressed, and shows none of it."""
        is_past = self._viewer.plays_recording
        for control in (self._mode, self._kind, self._family, self._own_mesh, self._handle):
            control.visible = not is_past
        if is_past:
            for slider in (self._number, *self._sliders.values()):
                slider.visible = False
            self._says.content = card_html("line", text=_NOT_PRESSED, margin="0.2em", size="0.9em", is_dim=True)
            self._followed = (-1, -1)
            return
        followed = self._viewer.options.sensor or 0, self._control.revision
        state = (
            self._control.state
        )  # read after its revision, so that a change in between is followed at the next refresh
        if followed != self._followed:
            self._followed = followed if self._follow(state) else (-1, -1)
        shown = self._viewer.choose_shown(moment)[0]
        self._says.content = _contact_html(shown)
        self._show_handle(state, shown)

    def _add_handle(self) -> None:
        """Add the handle with which the object is dragged in 3D; up and down is its depth."""
        limits = self._control.limits
        deep, high = (HANDLE_LIFT_MM - depth_mm for depth_mm in limits["depth_mm"][::-1])
        self._handle = self._viewer.client.scene.add_transform_controls(
            "/handle",
            _HANDLE_SCALE,
            translation_limits=(limits["x_mm"], limits["y_mm"], (deep, high)),
            depth_test=False,
            opacity=0.7,
        )
        self._handle.on_update(self._note_drag)
        self._handle.on_update(self._follow_drag)

    def _show_handle(self, state: HandPressState, moment: SensorMoment) -> None:
        press = None if moment.view is None else moment.view.press
        pose = press.pose if press is not None and (state.is_playing or state.by_load) else state.target.pose
        x, y, z = (float(part) for part in pose.origin_mm + np.array(self._place_mm))
        with self._noting:
            if not self._is_dragged and not self._dragged_to:
                self._handle.position = (round(x, 3), round(y, 3), round(z, 3) + HANDLE_LIFT_MM)
                self._handle.wxyz = SO3.from_matrix(np.asarray(pose.rotation)).wxyz

    async def _note_drag(self, event: TransformControlsEvent) -> None:
        """Note where the handle is dragged; a quaternion of length zero, which is no rotation, is passed over.

        viser runs coroutines in the order of the messages and before the page can set the handle; functions run later, in threads,
        in any order.
        """
        is_rotation = np.linalg.norm(event.target.wxyz) > _LEAST_QUATERNION
        with self._noting:
            self._is_dragged = event.phase != "end" and event.client is not None
            if event.phase == "update" and event.client is not None and is_rotation:
                origin_mm = np.array(event.target.position) - self._place_mm - (0.0, 0.0, HANDLE_LIFT_MM)
                pose = Pose.from_frame(origin_mm, SO3(np.asarray(event.target.wxyz)).as_matrix())
                self._dragged_to = pose_fields(pose)

    def _follow_drag(self, event: TransformControlsEvent) -> None:
        with self._moving:
            moved = self._dragged_to
            try:
                for control in self._pressed if moved else ():
                    control.move(by_load=False, **moved)
            finally:
                with self._noting:
                    self._dragged_to = {} if self._dragged_to is moved else self._dragged_to

    @property
    def _place_mm(self) -> tuple[float, float, float]:
        return self._viewer.arrangement.places_mm[0]

    def _choose_mode(self, event: GuiEvent[Any]) -> None:
        for control in self._pressed:
            if event.target.value == _SEQUENCE:
                control.play()
            else:
                control.move(by_load=event.target.value == _BY_LOAD)

    def _choose_object(self, event: GuiEvent[Any]) -> None:
        """Take another object, the first one of a kind that was not shown before."""
        kind, family = str(self._kind.value), str(self._family.value)
        if kind == OWN_KIND:
            (family,) = self._names_of_kind(kind)
        elif family not in OBJECTS_BY_KIND.get(kind, ()):
            family = OBJECTS_BY_KIND[kind][0] if kind in OBJECTS_BY_KIND else ""
        self._followed = (-1, -1)  # so that the controls show the present object again where this one is refused
        with self._viewer.notify_refusal("Not taken"):
            for control in self._pressed:
                control.choose(kind, family, int(self._number.value))

    def _move(self, name: str, event: GuiEvent[Any]) -> None:
        by_load = {"depth_mm": {"by_load": False}, "load_n": {"by_load": True}}.get(name, {})
        for control in self._pressed:
            control.move(**{name: float(event.target.value)}, **by_load)

    def _upload(self, event: GuiEvent[GuiUploadButtonHandle]) -> None:
        unit, side = str(self._unit.value), _SIDES.get(str(self._side.value), "-z")
        placement = MeshPlacement(unit if unit in MM_PER_UNIT else "mm", side, fit_mm=FIT_MM if unit == FIT else None)
        file = event.target.value
        if not isinstance(file, UploadedFile):  # any other value, which only a program can send
            return
        with self._viewer.notify_refusal("Mesh not taken"):
            said = {control.upload(file.name, file.content, placement) for control in self._pressed}
            self._viewer.notify("Mesh taken", " ".join(said), "green")

    def _names_of_kind(self, kind: str) -> tuple[str, ...]:
        """Return the objects of a kind; of one's own mesh, the one that was brought."""
        mesh = self._control.own_mesh
        return OBJECTS_BY_KIND.get(kind, ("" if mesh is None else mesh.name,))

    def _follow(self, state: HandPressState) -> bool:
        """Set all controls to the present state; return whether all show it, which one that is being changed does not yet."""
        names = self._names_of_kind(state.kind)
        if tuple(self._family.options) != names:
            self._family.options = names
        self._number.visible = state.kind not in ("primitives", OWN_KIND)
        self._sliders["depth_mm"].visible, self._sliders["load_n"].visible = not state.by_load, state.by_load
        chosen = (self._mode, _mode_of(state)), (self._kind, state.kind), (self._family, state.family)
        moved = ((slider, round(getattr(state, name), 3)) for name, slider in self._sliders.items())
        return self._follower.follow(*chosen, (self._number, state.number), *moved)


def _mode_of(state: HandPressState) -> str:
    return _SEQUENCE if state.is_playing else _BY_LOAD if state.by_load else _BY_DEPTH


def _contact_html(moment: SensorMoment) -> str:
    """Return what presses and how much of it slips, as HTML."""
    press = None if moment.view is None else moment.view.press
    if press is None:
        return ""
    depth_mm, slip = float(press.pose.depth_mm), press.slip_share
    height = f"{depth_mm:.2f} mm deep" if depth_mm >= 0 else f"{-depth_mm:.2f} mm above the skin"
    words = [f"{press.indenter.name}, {height}"]
    if slip is not None:
        words.append("sticks" if slip == 0 else "slips" if slip == 1 else f"slips on {slip:.0%} of the contact")
    return card_html("line", text=" · ".join(words), margin="0.2em", size="0.9em")
