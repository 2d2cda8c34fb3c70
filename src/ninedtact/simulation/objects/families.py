"""All families of generated objects by name."""

from collections.abc import Callable

from ninedtact.simulation.objects.lettering import LETTERING
from ninedtact.simulation.objects.machines import MACHINES
from ninedtact.simulation.objects.patterns import PATTERNS
from ninedtact.simulation.objects.punches import PUNCHES
from ninedtact.simulation.objects.rough import ROUGH
from ninedtact.simulation.objects.sheet import Draw, Heights, Sheet
from ninedtact.simulation.objects.solids import SOLIDS
from ninedtact.simulation.objects.things import THINGS

Family = Callable[[Draw, Sheet], Heights]

KINDS: dict[str, tuple[Family, ...]] = {
    "solids": SOLIDS,
    "punches": PUNCHES,
    "machine parts": MACHINES,
    "lettering": LETTERING,
    "patterns": PATTERNS,
    "rough surfaces": ROUGH,
    "things": THINGS,
}

FAMILIES: dict[str, Family] = {family.__name__: family for kind in KINDS.values() for family in kind}
"""In the order in which objects are counted out; an object does not depend on it."""
