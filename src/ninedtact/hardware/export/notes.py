"""Which dimensions of the design a part's drawing lists."""

from dataclasses import fields

from ninedtact.hardware.design import HardwareDesign

SHAPED_BY = {
    "sensor_base": "base",
    "sensor_shell": "shell",
    "isolation_ring": "ring",
    "acrylic_window": "window",
    "calibration_board": "pin_frame",
    "base_board": "moulds",
    "first_mould": "moulds",
    "second_mould": "moulds",
    "transparent_gel": "shell",
    "translucent_gel": "gels",
    "black_gel": "gels",
    "camera": "camera",
    "led_board": "board",
}
"""Table of the design file, by part."""


def notes(design: HardwareDesign, part: str) -> list[str]:
    """Each as `name value`, as it stands in the design file."""
    name = SHAPED_BY[part]
    dimensions = getattr(design, name)
    return [f"{name}.{field.name}  {told(getattr(dimensions, field.name))}" for field in fields(dimensions)]


def told(value: float | tuple[float, ...]) -> str:
    """Numbers as a person writes them."""
    return f"({', '.join(f'{each:g}' for each in value)})" if isinstance(value, tuple) else f"{value:g}"
