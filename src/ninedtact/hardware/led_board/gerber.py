"""Gerber layers (RS-274X with X2 attributes), millimetres, six decimals. Source: Ucamco's Gerber Layer Format Specification."""

from dataclasses import dataclass, field

from ninedtact.hardware.led_board.drawing import Area, Blob, Block, Disc, Shape, Stroke
from ninedtact.hardware.led_board.edge import Edge
from ninedtact.hardware.led_board.outline import Place

FIRST_APERTURE = 10
EDGE_MM = 0.1
"""Pen of the outline; its middle is the edge."""


@dataclass
class Plot:
    """Commands as they are drawn, and the apertures that they call for."""

    commands: list[str] = field(default_factory=list)
    apertures: list[str] = field(default_factory=list)
    macros: list[str] = field(default_factory=list)

    def choose(self, template: str) -> None:
        """Take an aperture, defined once."""
        if template not in self.apertures:
            self.apertures.append(template)
        self.commands.append(f"D{FIRST_APERTURE + self.apertures.index(template)}*")

    def macro(self, points: tuple[Place, ...]) -> str:
        """The name of an aperture of that shape, defined once."""
        corners = ",".join(f"{x:.6f},{y:.6f}" for x, y in (*points, points[0]))
        body = f"4,1,{len(points)},{corners},0*"
        if body not in self.macros:
            self.macros.append(body)
        return f"SHAPE{self.macros.index(body)}"

    def draw(self, shape: Shape) -> None:
        """Add one shape."""
        match shape:
            case Disc(at, diameter):
                self.choose(f"C,{diameter:.6f}")
                self.commands.append(f"{at_place(at)}D03*")
            case Block(at, (width, height)):
                self.choose(f"R,{width:.6f}X{height:.6f}")
                self.commands.append(f"{at_place(at)}D03*")
            case Blob(at, points):
                self.choose(self.macro(points))
                self.commands.append(f"{at_place(at)}D03*")
            case Stroke(width, points):
                self.choose(f"C,{width:.6f}")
                self.commands += path(points)
            case Area(points):
                self.commands += ["G36*", *path((*points, points[0])), "G37*"]

    def trace(self, edge: Edge) -> None:
        """Add a piece of the outline."""
        self.choose(f"C,{EDGE_MM:.6f}")
        self.commands.append(f"{at_place(edge.start_mm)}D02*")
        if edge.centre_mm is None:
            self.commands.append(f"{at_place(edge.end_mm)}D01*")
            return
        i, j = (centre - start for centre, start in zip(edge.centre_mm, edge.start_mm, strict=True))
        self.commands += ["G02*", f"{at_place(edge.end_mm)}I{steps(i)}J{steps(j)}D01*", "G01*"]

    def text(self, function: str, polarity: str = "Positive") -> str:
        """The file."""
        shapes = [f"%AMSHAPE{number}*{body}%" for number, body in enumerate(self.macros)]
        apertures = [f"%ADD{FIRST_APERTURE + number}{template}*%" for number, template in enumerate(self.apertures)]
        head = [
            f"%TF.FileFunction,{function}*%",
            f"%TF.FilePolarity,{polarity}*%",
            "%TF.SameCoordinates,ninedtact-led-board*%",
        ]
        setup = ["%FSLAX46Y46*%", "%MOMM*%", "%LPD*%"]
        return "\n".join([*head, *setup, *shapes, *apertures, "G75*", "G01*", *self.commands, "M02*", ""])


def plotted(shapes: tuple[Shape, ...], function: str, polarity: str = "Positive") -> str:
    """A layer as a Gerber file."""
    plot = Plot()
    for shape in shapes:
        plot.draw(shape)
    return plot.text(function, polarity)


def outlined(edges: tuple[Edge, ...]) -> str:
    """The milled edge as a Gerber file."""
    plot = Plot()
    for edge in edges:
        plot.trace(edge)
    return plot.text("Profile,NP")


def path(points: tuple[Place, ...]) -> list[str]:
    """Move to the first point, draw through the others."""
    return [f"{at_place(points[0])}D02*", *(f"{at_place(point)}D01*" for point in points[1:])]


def at_place(place: Place) -> str:
    """A place as coordinates."""
    return f"X{steps(place[0])}Y{steps(place[1])}"


def steps(length_mm: float) -> int:
    """A length in millionths of a millimetre."""
    return round(length_mm * 1e6)
