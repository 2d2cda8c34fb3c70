"""How far a patch is from a skin without end: what the periodic images of a contact do to its own skin."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.mechanics.patch import Patch
from ninedtact.mechanics.per_contact import on_cpu
from ninedtact.mechanics.touch import Contact


def image_error_mm(contact: Contact, times: int = 3) -> Float64[Array, "rows cols"]:
    """By how much the skin under one contact stands higher than the same tractions alone would have it.

    Against a patch `times` (odd) as long and as wide, which has images too, but far away.
    """
    patch = contact.skin.patch
    larger = replace(contact.skin, patch=Patch(times * patch.rows, times * patch.cols, patch.pitch_mm))
    around = [(0, 0), *((cells * (times // 2),) * 2 for cells in patch.shape)]
    tractions = np.pad(np.concatenate([on_cpu(contact.pressure_mpa)[None], on_cpu(contact.shear_mpa)]), around)
    alone, _ = larger.response.displaced_mm(larger.asarray(tractions[0]), larger.asarray(tractions[1:]))
    inside = tuple(slice(before, before + cells) for (before, _), cells in zip(around[1:], patch.shape, strict=True))
    return on_cpu(contact.height_mm) - on_cpu(alone)[inside]
