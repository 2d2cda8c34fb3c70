"""ninedtact model card: what a force model says about itself."""

from dataclasses import dataclass
from pathlib import Path

from ninedtact.cli.terminal import print_result


@dataclass(frozen=True)
class Show:
    """Print the card of a force model: what it was trained with, how good it is, and its limits."""

    model: Path | None = None
    """A force model (.onnx); the one that ships if not given."""
    json: bool = False
    """Print it as one JSON object."""

    def run(self) -> int:
        """Read it; raises `ModelUnusable`."""
        import msgspec

        from ninedtact.force.model_card_page import format_model_card
        from ninedtact.force.model_file import read_force_model
        from ninedtact.force.shipped import SHIPPED_MODEL

        card = read_force_model(self.model or SHIPPED_MODEL).card
        return print_result(self.json, msgspec.to_builtins(card), [format_model_card(card)])
