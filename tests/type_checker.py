"""How annotations are checked while the tests run."""

from beartype import BeartypeConf, beartype

checked = beartype(conf=BeartypeConf(is_pep484_tower=True))
"""With the numeric tower, as mypy has it: an int is a float."""
