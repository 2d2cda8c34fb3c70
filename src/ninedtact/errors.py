"""The one base class that the command line turns into a sentence and an exit code."""


class NinedtactError(Exception):
    """Something the user can act on; its message says what was expected, what came instead, and what to do.

    Each room derives its own, named in its own words (`BoardNotFound`, `CameraLost`).
    """
