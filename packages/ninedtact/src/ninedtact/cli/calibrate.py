"""`ninedtact calibrate`: one press of the pin board and one of the ball → a sensor folder with its certificate.

The four images come from files, from a folder, or from a camera; the board alone makes a sensor that rectifies, to which the ball
can be added later. With a camera the terminal guides a person through the two presses without any key: every step watches the
images, says what it detects, and continues once it has what it needs.
"""

import sys
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

import tyro
from msgspec import structs

from ninedtact.calibration.settings import CalibrationSettings
from ninedtact.cli.calibration_page import (
    CalibrationPageOptions,
    GuidedPages,
)
from ninedtact.cli.guided_capture import capture_guided_images, keep_images_of_failure
from ninedtact.cli.result_and_interrupt import (
    StepLine,
    calibration_json_dict,
    format_calibration,
    print_notice,
    print_notices,
    print_result,
    sensor_replacement,
)
from ninedtact.cli.shared_options import (
    CameraOption,
    CameraOptions,
    DesignFileOption,
    JsonOption,
    SizeOption,
    read_design_or_default,
)
from ninedtact.design import SECOND_KINDS, SecondKind, SensorDesign
from ninedtact.errors import InputError

if TYPE_CHECKING:
    from ninedtact.calibration.procedure import Calibration, CalibrationImages
    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.quantities import BgrImage

_IMAGE_NAMES = ("board_reference", "board", "ball_reference", "ball")
_IMAGE_OPTIONS = ", ".join("--" + name.replace("_", "-") for name in _IMAGE_NAMES)
_BOARD_NAMES, _BALL_NAMES = _IMAGE_NAMES[:2], _IMAGE_NAMES[2:]
_SECOND_NAMES = {kind: (f"{kind}_reference", kind) for kind in SECOND_KINDS}


@dataclass(frozen=True)
class CalibrateCommand:
    """Calibrate a sensor from one press of the pin board and one of the ball.

    Give the four images, or a folder of them, and the command asks nothing. Give --source, and the terminal guides you through
    the presses, or with --page a page in the browser. The two images of the board alone make a sensor that rectifies images; the
    two of the ball alone complete the sensor at --out, or an imported one.
    """

    out: Path
    """Sensor folder to write. An older calibration there is replaced, unless the new one fails its checks and the older one did
    not; the new one is then written to OUT_failed."""
    from_import: Path | None = None
    """Imported sensor, or sensor_N folder of the original project, whose rectification is kept; give it images of a ball."""
    board_reference: tuple[Path, ...] = ()
    """Reference image without contact, taken before the board. Several images are averaged."""
    board: tuple[Path, ...] = ()
    """Image of the pin board pressed on the gel."""
    ball_reference: tuple[Path, ...] = ()
    """Reference image without contact, taken before the ball."""
    ball: tuple[Path, ...] = ()
    """Image of the ball pressed straight down, 1 to 2 mm deep."""
    second_ball: tuple[Path, ...] = ()
    """Image of a second ball of another radius pressed on the same gel, which tells its base and so the true depth (--plan)."""
    second_ball_reference: tuple[Path, ...] = ()
    """Reference image without contact, taken before the second ball. Without it, that of the first ball is used."""
    flat_end: tuple[Path, ...] = ()
    """Image of the flat end of a round rod (shank of a drill, pin) let in to a known depth by a stop, which tells the same."""
    flat_end_reference: tuple[Path, ...] = ()
    """Reference image without contact, taken before the flat end. Without it, that of the ball is used."""
    images: Path | None = None
    """Folder with board_reference.png, board.png, ball_reference.png and ball.png, such as images/ of a sensor folder; images of a
    second ball or a flat end there (second_ball.png, flat_end.png, and their references) are used too."""
    source: str | None = None
    """Take the images with this camera (0, /dev/video0, the URL of a stream) or from a recording (a video, a folder); or sim, a
    simulated sensor, on which board and ball are pressed by themselves."""
    size: SizeOption = None
    camera: CameraOption = CameraOptions()
    ball_radius_mm: float | None = None
    """Radius of the ball. Without it, the design's radius is used (4 mm for the published sensor)."""
    second_ball_radius_mm: float | None = None
    """Radius of the second ball. Without it, the design's is used (2.5 mm for the published sensor); that of the first where the
    same ball is pressed again, to another depth."""
    with_second_ball: bool = False
    """With --source or --page: guide through the press of a second ball, too."""
    flat_end_radius_mm: float | None = None
    """Radius of the rod with the flat end. Without it, the design's is used (3 mm for the published sensor)."""
    flat_end_depth_mm: float | None = None
    """How deep the stop lets the flat end in, from the first touch. Images of a flat end need it."""
    flat_end_depth_error_mm: float | None = None
    """Standard deviation of that depth. Without it, the design's is used (0.03 mm)."""
    with_flat_end: bool = False
    """With --source or --page: guide through the press of a flat end, too. Without its lengths, the design's are used."""
    plan: bool = False
    """Calibrate nothing, but print by how much each second press would shrink what is not known of the ball's depth, the base,
    the thickness of the gel and a load: for the sensor at --out, or for the design where none is there."""
    id: str | None = None
    """Name of the sensor. Without it, the folder's name is used."""
    settings: Annotated[CalibrationSettings, tyro.conf.arg(name="")] = CalibrationSettings()
    on_page: Annotated[CalibrationPageOptions, tyro.conf.arg(name="")] = CalibrationPageOptions()
    design_file: DesignFileOption = None
    """Design file (TOML) with what differs from the published sensor. Its dimensions can also be given one by one, see below."""
    design: SensorDesign = SensorDesign()
    json: JsonOption = False

    def run(self) -> int:
        """Calibrate, write the sensor folder, and print how good it is."""
        from ninedtact.calibration.save import failed_calibration_notices
        from ninedtact.calibration.sensor_toml_schema import require_sensor_id

        require_sensor_id(self.sensor_id)
        if self.plan:
            from ninedtact.cli.press_plan_table import print_press_plan

            return print_press_plan(self.out, self.resolved_design, self.json)
        with sensor_replacement(self.out):
            sensor = self._calibrate_on_page() if self.on_page.page else self._calibrate_from_images()
        if sensor is None:
            print_notice(f"stopped before the calibration was complete; {self.out} is as it was")
            return 1
        print_notices(failed_calibration_notices(self.out, sensor))
        result = calibration_json_dict(sensor)
        print_result(self.json, result, format_calibration(sensor))
        return 1 if result["result"] == "fail" else 0

    @property
    def sensor_id(self) -> str:
        """Name of a sensor that is calibrated from the beginning."""
        return self.id or self.out.name or self.out.resolve().name  # without a name as in --out .

    def _calibrate_from_images(self) -> "SensorFolder":
        from ninedtact.calibration.board.detection import BoardNotFound
        from ninedtact.calibration.certificate.plot_board import save_board_not_found_drawing
        from ninedtact.calibration.save import save_sensor

        taken: dict[str, BgrImage] = {}
        with StepLine() as line, TemporaryDirectory() as scratch, keep_images_of_failure(self.out, taken):
            try:
                made = self._calibrate(self.obtain_images(taken), Path(scratch), line.show)
            except BoardNotFound as refusal:
                drawing = self.out.with_name(f"{self.out.name}_board_not_found.png")
                raise save_board_not_found_drawing(refusal, drawing) from refusal
            line.show("drawing the certificate")
            return save_sensor(self.out, made)

    def _calibrate_on_page(self) -> "SensorFolder | None":
        """Serve the guided calibration in the browser until Ctrl-C; None without a sensor; raises `InputError`."""
        images_given = self.images is not None or any(getattr(self, name) for name in _IMAGE_NAMES)
        if images_given or self.from_import is not None:
            raise InputError(
                expected="--page alone or with --source, since it takes the images itself",
                got="images or --from-import",
                remedy="drop --page",
            )
        design, settings, name = self.resolved_design, self.settings, self.sensor_id
        pages = GuidedPages(self.on_page, self.source, self.camera.settings(self.size))
        with redirect_stdout(sys.stderr if self.json else sys.stdout):
            return pages.calibrate_shape(self.out, name, design, settings, self._guided_second)

    def _calibrate(self, images: "CalibrationImages", scratch: Path, on_step: Callable[[str], None]) -> "Calibration":
        """Calibrate from all presses, or with images of a ball on the sensor that has the lens already."""
        from ninedtact.calibration.procedure import calibrate

        if images.board_pair is None and images.ball_pair is not None:
            return self._add_ball(self._lens_folder(scratch), images, on_step)
        if images.ball_pair is None:
            _require_no_depth_lost(self.out)
        return calibrate(images, self.resolved_design, self.settings, self.sensor_id, on_step)

    def _add_ball(
        self, folder: "SensorFolder", images: "CalibrationImages", on_step: Callable[[str], None]
    ) -> "Calibration":
        """Calibrate the depth of a sensor that has its lens already."""
        from ninedtact.calibration.procedure import repeat_calibration

        given, standard, kept = self.resolved_design, SensorDesign(), folder.record.design
        given_otherwise = replace(given, ball=kept.ball, flat_end=kept.flat_end)
        if given_otherwise not in (replace(standard, ball=kept.ball, flat_end=kept.flat_end), kept):
            raise InputError(
                expected=f"the design that {folder.path} was made with",
                got="another one",
                remedy="leave out --design, or give the images of the board as well",
            )
        _require_kept_lens(self.settings, folder)
        is_ball_given = self.ball_radius_mm is not None or given.ball.radius_mm != standard.ball.radius_mm
        is_flat_end_given = self._given_design.flat_end != standard.flat_end
        ball = given.ball if is_ball_given else kept.ball
        flat_end = self._given_design.flat_end if is_flat_end_given else kept.flat_end
        design = self._with_given_lengths(replace(kept, ball=ball, flat_end=flat_end))
        smoothing = None if self.settings.smoothing == CalibrationSettings().smoothing else self.settings.smoothing
        made = repeat_calibration(folder, self.settings.method, images, design, on_step, smoothing)
        return replace(made, record=structs.replace(made.record, id=self.id or folder.id))

    def _lens_folder(self, scratch: Path) -> "SensorFolder":
        """Return the sensor whose lens is kept: --from-import, or the sensor that is at --out; raises `InputError`."""
        from ninedtact.calibration.original_9dtact.import_export import import_original_calibration
        from ninedtact.calibration.sensor_folder import SENSOR_FILE, load_sensor

        origin = self.out if self.from_import is None else self.from_import
        if (origin / SENSOR_FILE).is_file():
            return load_sensor(origin)
        if self.from_import is None:
            raise InputError(
                expected="--out to be a sensor that was calibrated with the board",
                got=f"images of the ball alone and {self.out}, which is none",
                remedy="give the images of the board as well",
            )
        return import_original_calibration(origin, scratch / origin.resolve().name, self.resolved_design)

    @property
    def resolved_design(self) -> SensorDesign:
        """The design with the lengths that were given; raises `InputError` and what `read_design_file` raises."""
        return self._with_given_lengths(self._given_design)

    @property
    def _given_design(self) -> SensorDesign:
        """The design by its file or its single options; raises what `resolved_design` raises."""
        if self.design_file is None:
            return self.design
        if self.design != SensorDesign():
            raise InputError(
                expected=f"--design {self.design_file} or single --design.… options",
                got="both",
                remedy="write them into the file",
            )
        return read_design_or_default(self.design_file)

    def _with_given_lengths(self, design: SensorDesign) -> SensorDesign:
        """Return a design with the lengths of ball, second ball and flat end that were given."""
        ball = {"radius_mm": self.ball_radius_mm, "second_radius_mm": self.second_ball_radius_mm}
        flat_end = {
            "radius_mm": self.flat_end_radius_mm,
            "depth_mm": self.flat_end_depth_mm,
            "depth_error_mm": self.flat_end_depth_error_mm,
        }
        return replace(
            design,
            ball=replace(design.ball, **_stated(ball)),
            flat_end=replace(design.flat_end, **_stated(flat_end)),
        )

    @property
    def _guided_second(self) -> tuple[SecondKind, ...]:
        """The second objects through whose presses a person is guided."""
        return tuple(kind for kind in SECOND_KINDS if getattr(self, f"with_{kind}"))

    def _require_one_way_of_second_presses(self) -> None:
        """Raise `InputError` for a press that is to be guided without a camera, and for an image of one beside a camera."""
        for kind in SECOND_KINDS:
            option = kind.replace("_", "-")
            if kind in self._guided_second and self.source is None:
                raise InputError(
                    expected=f"--source or --page beside --with-{option}, which guides through the press",
                    got="neither",
                    remedy=f"give the image with --{option}",
                )
            if self.source is not None and getattr(self, kind):
                raise InputError(
                    expected=f"--with-{option} beside --source, which takes all images itself",
                    got=f"--{option}",
                    remedy=f"drop --{option}, or give all images",
                )

    def obtain_images(self, taken: "dict[str, BgrImage] | None" = None) -> "CalibrationImages":
        """Read the images of both presses, or of one, from files or from a folder, or take all with a camera.

        taken: receives each image that a camera takes, by its name, if it is given. Raises `InputError`.
        """
        given = [name for name in _IMAGE_NAMES if getattr(self, name)]
        self._require_one_way_of_second_presses()
        ways = [bool(given), self.images is not None, self.source is not None]
        if sum(ways) == 1 and self.source is not None and self.from_import is None:
            return capture_guided_images(
                self.source,
                self.resolved_design,
                self.settings,
                self.camera.settings(self.size),
                {} if taken is None else taken,
                self._guided_second,
            )
        if sum(ways) == 1 and self.images is not None:
            names = self._names_in(self.images)
            return self._read_images({name: (self.images / f"{name}.png",) for name in names})
        if sum(ways) == 1 and tuple(given) in self._complete_sets:
            return self._read_images({name: getattr(self, name) for name in given})
        got = ["--" + name.replace("_", "-") for name in given]
        got += [name for name, way in zip(("--images", "--source"), ways[1:], strict=True) if way]
        if self.from_import is not None:
            raise InputError(
                expected="--ball-reference and --ball beside --from-import, or --images with a folder of them",
                got=f"{', '.join(got) or 'none of them'}",
                remedy="give the two images of the ball",
            )
        raise InputError(
            expected=f"all of {_IMAGE_OPTIONS}, or the two of one press, or --images alone, or --source alone",
            got=f"{', '.join(got) or 'none of them'}",
            remedy="give the four images, a folder of them, or a camera",
        )

    @property
    def _complete_sets(self) -> tuple[tuple[str, ...], ...]:
        return (_BALL_NAMES,) if self.from_import is not None else (_IMAGE_NAMES, _BOARD_NAMES, _BALL_NAMES)

    def _names_in(self, folder: Path) -> tuple[str, ...]:
        """Return the images of a folder that are used: all four, or those of the only press that it has both images of."""
        there = tuple(name for name in _IMAGE_NAMES if (folder / f"{name}.png").exists())
        second = tuple(name for pair in _SECOND_NAMES.values() for name in pair if (folder / f"{name}.png").exists())
        if self.from_import is not None:
            return (*_BALL_NAMES, *second)
        return (*there, *second) if there in self._complete_sets else _IMAGE_NAMES

    def _require_flat_end_lengths(self) -> None:
        """Raise `InputError` unless radius and depth of the flat end are given, as options or by the design."""
        given = [self.flat_end_radius_mm, self.flat_end_depth_mm]
        if None in given and self._given_design.flat_end == SensorDesign().flat_end:
            got = "the radius" if given[0] is not None else "the depth" if given[1] is not None else "neither"
            raise InputError(
                expected="--flat-end-radius-mm and --flat-end-depth-mm beside an image of a flat end",
                got=f"{got} alone" if got != "neither" else got,
                remedy="measure the rod with a calliper, and the stop with a feeler gauge",
            )

    def _with_second_press(
        self, paths: dict[str, tuple[Path, ...]], reference: str, press: str
    ) -> dict[str, tuple[Path, ...]]:
        """Return the paths with those of a second press that were given; raises `InputError`."""
        paths = paths | {name: getattr(self, name) for name in (reference, press) if getattr(self, name)}
        option, name = "--" + press.replace("_", "-"), press.replace("_", " ")
        if press in paths and "ball" not in paths:
            raise InputError(
                expected=f"--ball beside {option}, since the two are fitted together",
                got=f"the {name} alone",
                remedy="give the images of the first ball as well",
            )
        if reference in paths and press not in paths:
            raise InputError(
                expected=f"{option} beside {option}-reference", got="the reference alone", remedy="give both"
            )
        return paths if press not in paths else {reference: paths["ball_reference"]} | paths

    def _read_images(self, paths: dict[str, tuple[Path, ...]]) -> "CalibrationImages":
        """Read the images at these paths, and those of second objects where they are given."""
        from ninedtact.calibration.procedure import CalibrationImages
        from ninedtact.capture.strict_image_reading import average_images, read_image

        for names in _SECOND_NAMES.values():
            paths = self._with_second_press(paths, *names)
        if "flat_end" in paths:
            self._require_flat_end_lengths()
        return CalibrationImages(
            **{name: average_images([read_image(path) for path in files]) for name, files in paths.items()}
        )


def _stated(values: dict[str, float | None]) -> dict[str, float]:
    return {name: value for name, value in values.items() if value is not None}


def _require_no_depth_lost(out: Path) -> None:
    from ninedtact.calibration.sensor_folder import SENSOR_FILE, load_sensor

    if (out / SENSOR_FILE).is_file() and load_sensor(out).record.depth is not None:
        raise InputError(
            expected=f"images of the ball as well, since {out} is calibrated for depth",
            got="those of the board alone",
            remedy="give all four, or choose another --out",
        )


def _require_kept_lens(settings: CalibrationSettings, folder: "SensorFolder") -> None:
    """Raise `InputError` for another lens or camera rotation than those of a sensor that keeps its lens."""
    from ninedtact.calibration.sensor_toml_schema import PinMapTable

    asked, kept = settings.camera_rotation_deg, folder.record.grid.camera_rotation_deg
    refused = [] if asked in ("auto", kept) else [f"--camera-rotation-deg {asked}"]
    if settings.camera_mirrored and not folder.record.grid.camera_mirrored:
        refused.append("--camera-mirrored")
    if settings.lens == "paper" and not isinstance(folder.record.lens, PinMapTable):
        refused.append("--lens paper")
    if refused:
        raise InputError(
            expected=f"the lens and the camera rotation ({kept}°) of {folder.path}, which images of the ball "
            "alone keep",
            got=f"{' and '.join(refused)}",
            remedy="leave that out, or give the images of the board as well",
        )
