"""Rules that a design must keep before anything is built: a hardware design goes in, broken rules with expected, got
and remedy come out.

`rule_check.find_broken_rules` applies all rules, `rule_check.require_buildable_design` raises `DesignRulesBroken`.
"""
