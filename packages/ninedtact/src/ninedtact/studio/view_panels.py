"""The panels with which a viewer looks at a moment: two images, the choice of views, and the profile of heights along a line."""

from functools import partial
from typing import Any

import cv2
import numpy as np
from viser import GuiApi, GuiEvent, GuiImageHandle, Icon, SceneClickEvent, uplot

from ninedtact.shape.coloured_height_map import ColourScale
from ninedtact.studio.followed_object import FollowedObject
from ninedtact.studio.page_cards import (
    card_html,
    height_legend_html,
    magnitude_legend_html,
    profile_summary_html,
    sticking_legend_html,
)
from ninedtact.studio.page_controller import PageMoment, SensorMoment
from ninedtact.studio.reading_view import (
    JPEG_QUALITY,
    PROFILE_POINTS,
    ImageKind,
    ReadingView,
    ShownTraction,
    SkinColouring,
    tile_sensor_images,
)
from ninedtact.studio.scene_3d import SkinScene
from ninedtact.studio.viewer import (
    MAX_EXAGGERATION,
    Side,
    ViewerPage,
    ViewOptions,
    add_theme_choice,
    on_user_change,
)

BLANK = np.full((3, 4, 3), 90, np.uint8)


class ImagesPanel:
    """Two images of the viewer's choice, each with the meaning of its colours."""

    title, icon = "Images", Icon.PHOTO
    side: Side = "left"

    def __init__(self, viewer: ViewerPage) -> None:
        self._viewer, self._scale = viewer, viewer.controller.scale
        self._images: list[GuiImageHandle] = []

    def build(self, gui: GuiApi) -> None:
        """Add both images under their menus."""
        gui.add_html("<span data-two-images></span>")
        self._legends = []
        for slot, kind in enumerate(self._viewer.options.images):
            menu = gui.add_dropdown(f"image {slot + 1}", [str(choice) for choice in ImageKind], initial_value=str(kind))
            on_user_change(menu, partial(self._choose, slot))
            self._images.append(gui.add_image(BLANK, format="jpeg", jpeg_quality=JPEG_QUALITY))
            self._legends.append(gui.add_html(""))

    def update(self, moment: PageMoment) -> None:
        """Draw both images."""
        shown, options = self._viewer.choose_shown(moment), self._viewer.options
        views = {one.name: one.view for one in shown if one.view is not None}
        if not views:
            return
        first = next(iter(views.values()))
        for image, legend, kind in zip(self._images, self._legends, options.images, strict=True):
            if len(views) > 1:
                bgr = tile_sensor_images(views, kind, options.with_outline, options.source)
            else:
                bgr = first.image(kind, options.with_outline, options.source)
            image.image = np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB))
            legend.content = _legend_html(first, kind, self._scale, options.source)

    def _choose(self, slot: int, event: GuiEvent[Any]) -> None:
        first, second = self._viewer.options.images
        kind = ImageKind(event.target.value)
        self._viewer.choose(images=(kind, second) if slot == 0 else (first, kind))


class ScenePanel:
    """The choice of views, and the scene in 3D that it applies to."""

    title, icon = "View", Icon.EYE
    side: Side = "right"

    def __init__(self, viewer: ViewerPage) -> None:
        self._viewer = viewer
        self._drawn: dict[int, tuple[int, int, ViewOptions]] = {}
        self._stood = 0 if viewer.is_narrow else 1

    def build(self, gui: GuiApi) -> None:
        """Add the menus, and the scene."""
        viewer, options = self._viewer, self._viewer.options
        scene, sensors = viewer.client.scene, viewer.controller.sensors
        self._frames = [scene.add_frame(f"/sensor_{n}", show_axes=False) for n in range(len(sensors))]
        self._scenes = [
            SkinScene(scene, viewer.block, frame.name, sensor.name)
            for frame, sensor in zip(self._frames, sensors, strict=True)
        ]
        colouring = gui.add_dropdown(
            "surface colouring", [str(each) for each in SkinColouring], initial_value=str(options.colouring)
        )
        times = gui.add_slider("vertical exaggeration", 1.0, MAX_EXAGGERATION, 0.5, 1.0, hint="1 is true to scale")
        self._add_choice(gui, "with_outline", "contact outline")
        self._add_choice(gui, "with_path", "path of the object", "blue: estimated; orange: true, on a twin")
        source = gui.add_dropdown(
            "pressure and shear",
            [str(each) for each in ShownTraction],
            initial_value=str(options.source),
            hint="those of the estimate; on a twin those of the simulation",
        )
        self._add_choice(gui, "pressure_arrows", "pressure as arrows")
        self._add_choice(gui, "shear_arrows", "shear as arrows")
        add_theme_choice(viewer.client)
        on_user_change(colouring, lambda event: viewer.choose(colouring=SkinColouring(event.target.value)))
        on_user_change(
            times, lambda event: viewer.choose(exaggeration=float(np.clip(event.target.value, 1, MAX_EXAGGERATION)))
        )
        on_user_change(source, lambda event: viewer.choose(source=ShownTraction(event.target.value)))

    def _add_choice(self, gui: GuiApi, option: str, label: str, hint: str | None = None) -> None:
        """Add a box that switches an option of the viewer."""
        box = gui.add_checkbox(label, getattr(self._viewer.options, option), hint=hint)
        on_user_change(box, lambda event: self._viewer.choose(**{option: event.target.value}))

    def update(self, moment: PageMoment) -> None:
        """Draw the scene where it differs from what was drawn last; a recording may have fewer sensors than the page."""
        chosen = self._viewer.options.sensor
        shown = range(len(self._scenes)) if chosen is None else (min(chosen, len(self._scenes) - 1),)
        arrangement = self._viewer.arrangement
        drawn = dict(zip(shown, self._viewer.choose_shown(moment), strict=False))
        for number, frame in enumerate(self._frames):
            frame.visible = number in drawn
        for number, place in zip(shown, arrangement.places_mm, strict=True):
            self._frames[number].position = place
            if number in drawn:
                self._draw(number, drawn[number])
        if len(shown) != self._stood:
            self._stood = len(shown)
            camera = self._viewer.client.camera
            camera.position, camera.look_at = arrangement.camera_mm, arrangement.target_mm

    def _draw(self, number: int, moment: SensorMoment) -> None:
        view, options, scene = moment.view, self._viewer.options, self._scenes[number]
        if view is None:
            return
        is_past = moment.status.is_past
        first = moment.wrenches[0].sample if moment.wrenches and not is_past else None
        scene.show_wrench(None if first is None else first.wrench)
        is_profiled = number == self._viewer.profiled_sensor
        drawn = id(view), moment.followed.stamp_ns, options
        if self._drawn.get(number) == drawn:
            return
        self._drawn[number] = drawn
        scene.exaggerate(options.exaggeration)
        as_points = options.colouring is not SkinColouring.PLAIN
        scene.show_surface(view.surface(options.colouring, options.coarser, options.source), as_points, is_past)
        line = view.profile(*options.profile_mm).points_mm if options.with_profile and is_profiled else None
        scene.show_lines(view.outline_mm() if options.with_outline and not is_past else None, line)
        tractions = view.tractions(options.source)
        wants_arrows = options.pressure_arrows or options.shear_arrows
        scene.show_tractions(
            tractions.arrows_mm(view.reading.height, options.pressure_arrows, options.shear_arrows)
            if wants_arrows and tractions is not None
            else None
        )
        scene.show_path(moment.followed if options.with_path and not is_past else FollowedObject())
        scene.show_object(view.press)


class ProfilePanel:
    """A point or a line on the skin, with the heights along it in mm, which follow the stream."""

    title, icon = "Profile", Icon.CHART_LINE
    side: Side = "right"

    def __init__(self, viewer: ViewerPage) -> None:
        self._viewer = viewer
        self._picks = 0

    def build(self, gui: GuiApi) -> None:
        """Add the ends of the line and the plot."""
        (start, end), block = self._viewer.options.profile_mm, self._viewer.block
        least, most = (-block.width_mm / 2, -block.length_mm / 2), (block.width_mm / 2, block.length_mm / 2)
        self._shown = gui.add_checkbox("line on the skin", self._viewer.options.with_profile)
        self._start = gui.add_vector2("A: x, y (mm)", start, min=least, max=most, step=0.1)
        self._end = gui.add_vector2("B: x, y (mm)", end, min=least, max=most, step=0.1)
        picks = gui.add_checkbox("pick on the skin", False, hint="a click or tap on the skin sets A, then B")
        gui.add_html(card_html("line", text="Shift and click does the same at any time.", size="0.8em"))
        self._text = gui.add_html("")
        self._plot = gui.add_uplot(
            (np.zeros(PROFILE_POINTS),) * 3,
            (
                uplot.Series(label="mm from A"),
                uplot.Series(label="height (mm), from the image", stroke="#0072b2", width=1.5),
                uplot.Series(label="height (mm), true", stroke="#d55e00", width=1.5, dash=(5.0, 4.0)),
            ),
            scales={"x": uplot.Scale(time=False), "y": uplot.Scale()},
            title="height (mm) from A to B; true is dashed",
            height=190,
        )
        self._shown.on_update(lambda event: self._viewer.choose(with_profile=event.target.value))
        for point in (self._start, self._end):
            on_user_change(point, lambda event: self._show_line())
        picks.on_update(lambda event: self._listen(is_picking=bool(event.target.value)))
        self._listen(is_picking=False)

    def update(self, moment: PageMoment) -> None:
        """Plot the heights along the line."""
        view = moment.sensors[min(self._viewer.profiled_sensor, len(moment.sensors) - 1)].view
        if view is None:
            return
        profile = view.profile(*self._viewer.options.profile_mm)
        true = np.full(PROFILE_POINTS, np.nan) if profile.true_mm is None else profile.true_mm
        self._plot.data = (profile.distance_mm, profile.height_mm, true)
        self._text.content = profile_summary_html(profile)

    def _show_line(self) -> None:
        self._shown.value = True
        self._viewer.choose(profile_mm=(self._start.value, self._end.value), with_profile=True)

    def _listen(self, is_picking: bool) -> None:
        """Pick with every click on the scene, or only with those while Shift is held, which a phone has not."""
        scene = self._viewer.client.scene
        scene.remove_click_callback()
        scene.on_click(modifier="shift")(self._pick)
        if is_picking:
            scene.on_click()(self._pick)

    def _pick(self, event: SceneClickEvent) -> None:
        """Move A or B, in turn, to where the line of sight of a click meets the plane of the undeformed skin.

        Of several skins it is the one whose middle is nearest; outside of it, the nearest place on its edge is taken.
        """
        origin, direction = np.array(event.ray_origin), np.array(event.ray_direction)
        if abs(direction[2]) < 1e-6:
            return
        from_middles_mm = origin - direction * origin[2] / direction[2] - self._viewer.arrangement.places_mm
        nearest = int(np.linalg.norm(from_middles_mm, axis=1).argmin())
        half_mm = np.array([self._viewer.block.width_mm, self._viewer.block.length_mm]) / 2
        x, y = np.clip(from_middles_mm[nearest, :2], -half_mm, half_mm).tolist()
        point = self._start if self._picks % 2 == 0 else self._end
        self._picks += 1
        point.value = (round(x, 1), round(y, 1))
        if self._viewer.options.sensor is None:
            self._viewer.choose(profile_sensor=nearest)
        self._show_line()


def _legend_html(view: ReadingView, kind: ImageKind, scale: ColourScale, source: ShownTraction) -> str:
    if kind is ImageKind.HEIGHT:
        return height_legend_html(scale)
    if kind is ImageKind.STICKING:
        return sticking_legend_html()
    end_mpa = view.scale_end_mpa(kind, source)
    return "" if end_mpa is None else magnitude_legend_html(f"{kind}, {source}", end_mpa)
