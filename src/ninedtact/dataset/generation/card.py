"""What a person reads of a data set, and Hugging Face too: README.md with the settings that make it again."""

import json
from collections.abc import Iterable

from ninedtact.dataset.generation.settings import DatasetSettings

HEAD = """\
---
pretty_name: 9DTact twin, images and wrenches
tags: [tactile-sensing, robotics, simulation]
configs:
- config_name: default
  data_files:
  - split: train
    path: data/train-*.parquet
- config_name: references
  data_files:
  - split: train
    path: references.parquet
---
"""


def card(
    settings: DatasetSettings, version: str, sizes: dict[str, int], percentiles: Iterable[str], device: str = "cpu"
) -> str:
    """The whole text. sizes: pairs of each kind."""
    machine = "the same machine" if device == "cpu" else f"the same machine with `--device {device}`"
    counted = ", ".join(f"{count} {kind}" for kind, count in sizes.items())
    width_mm = settings.design.sensing_area.width_mm
    table = "\n".join(f"    {line}".rstrip() for line in percentiles)
    return f"""{HEAD}
# Images and wrenches of simulated 9DTact sensors

Made by `ninedtact simulate dataset` {version}: {settings.pairs} pairs ({counted}) of {settings.sensors} sensors and
{len(settings.object_names)} objects. No real image is in it.

| column | what |
|---|---|
| image | the rectified sensor image, grey, {settings.size[0]} x {settings.size[1]}, {width_mm:g} mm across |
| mm_per_px | its scale |
| reference | id of the untouched image of the same sensor, in config `references` |
| wrench | Fx Fy Fz in N, Tx Ty Tz in N·m, of the object on the skin: pressing gives Fz < 0 |
| object | what touches; `none` where nothing does |
| contact | session and touch: rows that share it are of one continuous contact |
| step, time_ns | within the session, ten steps a second |
| sensor | its numbers are in `members/sensors.json` |
| kind | `rule`: kept by the paper's rule for collecting; `light_touch`: |Fz| < {settings.light_below_n:g} N; `no_contact` |

Torques are about the centre of the untouched skin. Sensor frame: x along columns, y along rows, z outward through the skin.
`wrench` is exact, as the contact mechanics says; a real force/torque sensor adds noise.

## Percentiles

{table}

## To make it again

The same version with these settings gives the same bytes on {machine}:

    {json.dumps(settings.as_table())}
"""
