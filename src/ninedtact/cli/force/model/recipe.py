"""What a force model is made of: twins to learn from, and other twins touched by other objects to be judged on."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ninedtact.design import SensorDesign

if TYPE_CHECKING:
    from ninedtact.cli.force.train import Precision
    from ninedtact.cli.force.training_data import HeldOut
    from ninedtact.dataset.generation.settings import GenerationSettings

HELD_OUT = frozenset(
    (
        *("cells", "dial", "saddle", "profile_bar", "pyramid", "foam", "spring", "ring", "punch"),
        *("letter", "puzzle", "molar", "blob", "ball", "caltrop", "cylinder", "dots", "spiral"),
    )
)
"""18 families of objects, drawn once; no training sees one of them, so that what is judged is not a sibling of what was learnt."""
LEARN_SEED, JUDGE_SEED, SHOW_SEED = 0, 2, 3
"""Of the sensors: no two share one."""


@dataclass(frozen=True)
class Recipe:
    """How much of everything."""

    pairs: int
    sensors: int
    epochs: int
    judged_pairs: int
    judged_sensors: int
    held_out: "HeldOut | None" = None
    """What the epoch is chosen by; None: sensors and objects that are not learnt."""
    precision: "Precision" = "32-true"
    pitch_mm: float = 0.3
    judged_pitch_mm: float = 0.2
    """Of the grids on which contacts are solved: what is judged on is solved finer than what is learnt from."""
    design: SensorDesign = SensorDesign()
    """What all twins were meant to be."""

    @property
    def to_learn(self) -> "GenerationSettings":
        """Sensors of all mechanics, objects that are not held out."""
        from ninedtact.dataset.generation.settings import GenerationSettings

        return GenerationSettings(
            self.pairs,
            sensors=self.sensors,
            object_names=objects(held_out=False),
            seed=LEARN_SEED,
            pitch_mm=self.pitch_mm,
            design=self.design,
        )

    @property
    def to_judge(self) -> "GenerationSettings":
        """Other sensors, most of them with the mechanics that estimators assume, and the objects held out."""
        from ninedtact.dataset.generation.settings import GenerationSettings
        from ninedtact.simulation.sensor_population import MechanicsShares

        return GenerationSettings(
            self.judged_pairs,
            sensors=self.judged_sensors,
            object_names=objects(held_out=True),
            seed=JUDGE_SEED,
            mechanics=MechanicsShares(compliant_base=0.15, finite_strain=0.15),
            pitch_mm=self.judged_pitch_mm,
            design=self.design,
        )


def objects(held_out: bool) -> tuple[str, ...]:
    """Names of as many generated objects as the paper has, those held out or all others."""
    from ninedtact.simulation.objects.catalogue import PAPER_COUNT, generated_object_names

    return tuple(
        name for name in generated_object_names(PAPER_COUNT) if (name.rsplit("_", 1)[0] in HELD_OUT) == held_out
    )


RECIPES = {
    "small": Recipe(pairs=2400, sensors=12, epochs=12, judged_pairs=600, judged_sensors=6, judged_pitch_mm=0.3),
    "shipped": Recipe(
        pairs=40_000, sensors=120, epochs=20, judged_pairs=14_000, judged_sensors=48, precision="bf16-mixed"
    ),
}
"""small: minutes, to see that it works and how; shipped: the model of the package, an evening on two cores."""
