"""What this room refuses."""

from ninedtact.design import DesignImpossible


class BoardImpossible(DesignImpossible):
    """A circuit board that cannot be laid out, made, or lit; the message names the rule."""
