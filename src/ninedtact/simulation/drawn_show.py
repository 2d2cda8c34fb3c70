"""Several presses below each other: image, true heights, reconstructed heights, and the wrench.

matplotlib is slow to import, so it is imported when a figure is drawn; its global state is never touched.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import TYPE_CHECKING, Any

from ninedtact.quantities import HeightMap, Wrench
from ninedtact.simulation.drawn_press import DPI, INK, titled
from ninedtact.simulation.image import Image
from ninedtact.simulation.truth import mean_error_mm

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class Answer:
    """One press of a twin, and what a sensor made of its image."""

    name: str
    image: Image
    true: HeightMap
    seen: HeightMap
    wrench: Wrench

    @property
    def peaks_mm(self) -> tuple[float, float]:
        """Deepest indentation, true and seen."""
        return float(-self.true.z_mm.min()), float(-self.seen.z_mm.min())

    @property
    def mean_error_mm(self) -> float:
        """Mean absolute error where the skin is pressed in."""
        return mean_error_mm(self.true, self.seen)


def drawn_show(answers: Sequence[Answer]) -> bytes:
    """All of them as one PNG."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14.6, 2.55 * len(answers)), dpi=DPI, facecolor="white", layout="constrained")
    rows = figure.subplots(len(answers), 4, squeeze=False, width_ratios=[1, 1, 1, 1.1])
    deepest, highest = (max(limit(answer) for answer in answers) for limit in (deepest_mm, highest_mm))
    for (image, true, seen, words), answer in zip(rows, answers, strict=True):
        image.imshow(answer.image[..., ::-1])
        titled(image, answer.name)
        for axes, height, title in (
            (true, answer.true, "true height"),
            (seen, answer.seen, "reconstructed from the image"),
        ):
            shown = draw_height(axes, height, deepest, highest)
            titled(axes, title)
        for axes in (image, true, seen):
            axes.set(xticks=[], yticks=[])
        figure.colorbar(shown, ax=seen, label="height (mm)")
        words.axis("off")
        words.text(0, 0.95, in_words(answer), va="top", family="monospace", size=9.5, color=INK, linespacing=1.5)
    buffer = BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def deepest_mm(answer: Answer) -> float:
    """Of both heights."""
    return max(*answer.peaks_mm, 0.05)


def highest_mm(answer: Answer) -> float:
    """Of both heights."""
    return float(max(answer.true.z_mm.max(), answer.seen.z_mm.max(), 0.05))


def draw_height(axes: "Axes", height: HeightMap, deepest: float, highest: float) -> Any:
    """Blue where pressed in, red where it bulges, alike in all rows."""
    from matplotlib.colors import TwoSlopeNorm

    return axes.imshow(height.z_mm, cmap="RdBu_r", norm=TwoSlopeNorm(0, -deepest, highest))


def in_words(answer: Answer) -> str:
    """Depths and wrench."""
    true, seen = answer.peaks_mm
    lines = [
        f"deepest: true {true:.2f} mm, seen {seen:.2f} mm",
        f"mean error where pressed: {answer.mean_error_mm:.3f} mm",
        "",
        "true wrench, about the skin's centre",
    ]
    pairs = zip("xyz", answer.wrench.force_n.tolist(), (1e3 * answer.wrench.torque_nm).tolist(), strict=True)
    lines += [f"F_{axis} {force:+7.2f} N   T_{axis} {torque:+7.2f} mN·m" for axis, force, torque in pairs]
    return "\n".join(lines).replace(" -", " \N{MINUS SIGN}")
