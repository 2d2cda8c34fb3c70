"""Rules that a design must keep before anything is built: a hardware design goes in, broken rules with expected, got
and remedy come out.

`find_broken_rules` applies all rules, `require_buildable_design` raises `DesignRulesBroken`.
"""

from ninedtact.hardware.buildability.mechanical_rules import MECHANICAL_RULES, BrokenRule, DesignRulesBroken
from ninedtact.hardware.buildability.moulding_and_view_rules import MOULDING_AND_VIEW_RULES
from ninedtact.hardware.design import HardwareDesign

DESIGN_RULES = (*MECHANICAL_RULES, *MOULDING_AND_VIEW_RULES)


def find_broken_rules(design: HardwareDesign) -> list[BrokenRule]:
    """Return every rule that a design breaks; none if it can be built."""
    return [broken for rule in DESIGN_RULES for broken in rule(design)]


def require_buildable_design(design: HardwareDesign) -> None:
    """Refuse a design that cannot be built; raises `DesignRulesBroken`."""
    if broken := find_broken_rules(design):
        raise DesignRulesBroken(broken)
