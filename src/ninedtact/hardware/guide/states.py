"""The parts as they are after each step, and from where they are looked at."""

from collections.abc import Iterator
from dataclasses import dataclass

from build123d import Axis, Part, Pos, Rot

from ninedtact.hardware.assembly.bodies import Body
from ninedtact.hardware.guide.steps import State
from ninedtact.hardware.images.scenes import coloured, cut_open
from ninedtact.hardware.images.shaded import ABOVE, BELOW, Eye, Image, shaded
from ninedtact.hardware.materials import MADE_OF
from ninedtact.hardware.report import BuiltSensor

SIZE_PX = 800, 600
CUT = Eye(-68.0, 24.0)
BETWEEN_MM = 24.0
"""Of two parts that stand beside one another."""


@dataclass(frozen=True)
class Scene:
    """What an image shows."""

    bodies: list[Body]
    eye: Eye = ABOVE
    cut: bool = False
    """The half at -y taken away."""

    def image(self) -> Image:
        """Drawn."""
        return shaded(coloured(cut_open(self.bodies) if self.cut else self.bodies), self.eye, SIZE_PX)


@dataclass(frozen=True)
class States:
    """Every state of one sensor's parts."""

    sensor: BuiltSensor

    def scene(self, state: State) -> Scene:
        """Of this step."""
        return {
            "inserts": lambda: Scene([*self.base(), *self.beside(self.shell())]),
            "window": lambda: Scene([*self.shell(), self.body("acrylic_window", 6.0)]),
            "transparent": lambda: Scene(self.filled(), CUT, cut=True),
            "first_mould": lambda: Scene([*self.clamped(14.0), self.mould("first_mould", 12.0)]),
            "translucent": lambda: Scene(
                [*self.clamped(), self.mould("first_mould"), self.body("translucent_gel")], CUT, cut=True
            ),
            "black": lambda: Scene(
                [*self.clamped(), self.mould("second_mould"), self.body("translucent_gel"), self.body("black_gel")],
                CUT,
                cut=True,
            ),
            "demoulded": lambda: Scene(self.gelled()),
            "camera": lambda: Scene([*self.base(), self.body("camera")]),
            "board": lambda: Scene([*self.base(), self.body("camera"), self.body("led_board")]),
            "ring": lambda: Scene([*self.gelled(), self.body("isolation_ring", -14.0)], BELOW),
            "closed": lambda: Scene(self.sensor.bodies),
            "calibrated": lambda: Scene([*self.sensor.bodies, self.tray()], Eye(-52.0, -20.0)),
        }[state]()

    def beside(self, bodies: list[Body]) -> Iterator[Body]:
        """The same standing next to the middle, upside down on the shell's rim."""
        design = self.sensor.design
        away, rim = design.plan.outer[0] + BETWEEN_MM, design.levels.rim
        for body in bodies:
            turned = body.solid.rotate(Axis.X, 180)
            yield Body(body.name, Part() + Pos(away, 0, rim) * turned, body.material)

    def body(self, name: str, lift_mm: float = 0.0) -> Body:
        """One part, lifted out of its place."""
        return Body(name, Pos(0, 0, lift_mm) * self.sensor.parts[name].solid, MADE_OF[name])

    def base(self) -> list[Body]:
        """With its inserts."""
        return [self.body("sensor_base"), *self.inserts(range(1, 5))]

    def shell(self) -> list[Body]:
        """With its inserts."""
        return [self.body("sensor_shell"), *self.inserts(range(5, 9))]

    def inserts(self, numbers: range) -> Iterator[Body]:
        """Those of the base are 1 to 4, those of the shell 5 to 8."""
        names = {f"insert_{number}" for number in numbers}
        return (body for body in self.sensor.bodies if body.name in names)

    def filled(self) -> list[Body]:
        """Shell, window, transparent gel."""
        return [*self.shell(), self.body("acrylic_window"), self.body("transparent_gel")]

    def gelled(self) -> list[Body]:
        """All layers cured."""
        return [*self.filled(), self.body("translucent_gel"), self.body("black_gel")]

    def clamped(self, drop_mm: float = 0.0) -> list[Body]:
        """The filled shell on the base board."""
        design = self.sensor.design
        under = design.levels.plate_top - design.moulds.base_mm - drop_mm
        return [*self.filled(), self.body("base_board", under)]

    def mould(self, name: str, lift_mm: float = 0.0) -> Body:
        """A mould on the shell's rim."""
        return self.body(name, self.sensor.design.levels.rim + lift_mm)

    def tray(self) -> Body:
        """The calibration board over the sensor, its pins a little above the skin."""
        design = self.sensor.design
        tip = design.pin_frame.floor_mm + design.pin_frame.pin_tall_mm
        turned = Rot(180, 0, 0) * self.sensor.parts["calibration_board"].solid
        above = design.levels.top + tip + 12.0
        return Body("calibration_board", Part() + Pos(0, 0, above) * turned, MADE_OF["calibration_board"])
