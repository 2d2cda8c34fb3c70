"""The rules of the board as a KiCad project, so that KiCad's own check asks for the same."""

import json

from ninedtact.hardware.led_board.design import LedBoard


def kicad_project(board: LedBoard, name: str) -> str:
    """The file's text."""
    rules, copper = board.rules, board.copper
    least = {
        "min_clearance": rules.clearance_mm,
        "min_copper_edge_clearance": rules.copper_to_edge_mm,
        "min_hole_clearance": rules.copper_to_hole_mm,
        "min_hole_to_hole": rules.hole_to_hole_mm,
        "min_track_width": min(copper.led_mm, copper.ground_mm, copper.supply_mm, copper.neck_mm, copper.signal_mm),
        "min_via_diameter": copper.via_mm,
        "min_through_hole_diameter": copper.via_drill_mm,
        "min_via_annular_width": (copper.via_mm - copper.via_drill_mm) / 2 - 0.001,
    }
    usual = {
        "name": "Default",
        "clearance": rules.clearance_mm,
        "track_width": copper.signal_mm,
        "via_diameter": copper.via_mm,
        "via_drill": copper.via_drill_mm,
    }
    content = {
        "board": {"design_settings": {"rules": least}},
        "meta": {"filename": f"{name}.kicad_pro", "version": 1},
        "net_settings": {"classes": [usual], "meta": {"version": 2}},
    }
    return json.dumps(content, indent=2) + "\n"
