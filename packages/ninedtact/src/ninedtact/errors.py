"""The errors of the package: one base class, and under it the classes that a program catches.

    NinedtactError
    ├── InputError             a value, an option, a design or an object that cannot be used
    ├── FileFormatError        a file or folder that is missing, damaged, or of another format
    ├── OutputError            a file or folder that cannot be written, or not without overwriting something else
    ├── MissingLibraryError    an optional library that is not installed
    ├── CameraError            a camera or another source of images
    ├── DeviceError            a force/torque sensor, a graphics processor, a network port
    ├── CalibrationError       calibration images, a sensor's calibration, its reference image
    ├── ForceEstimationError   force estimation, force models and their training
    ├── SimulationError        contact mechanics and simulated sensors
    └── DatasetError           recordings in progress and data sets: no usable pairs, faults found, work stopped

An error that a program may want to tell apart from the others of its group has a class of its own (`BoardNotFound`, `CameraLost`).
The sentence of an error is data: what was expected, what was found (`got`), and what to do (`remedy`). The command line prints it
as one line and ends with exit code 1.

>>> try:
...     ninedtact.load_sensor("no_such_folder")
... except ninedtact.errors.FileFormatError as error:
...     print(error)
"""

import re

UNPRINTABLE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
"""Control characters but line breaks and tabs, those that change the direction of text, and bytes that are not UTF-8."""


def printable_text(text: str) -> str:
    r"""Return text for terminals and files of UTF-8; what a name of a stranger may hide in it becomes escape sequences.

    >>> print(printable_text("left\x1b[31m"))
    left\x1b[31m
    """
    return UNPRINTABLE.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


_SENTENCE = re.compile(r"expected (.*?), got:? (.*?); (.*)", re.DOTALL)


class NinedtactError(Exception):
    """An error that the user can act on; it says what was expected, what was found, and what to do.

    >>> print(ninedtact.NinedtactError(expected="a load above 0 N", got="-1 N", remedy="give a larger one"))
    expected a load above 0 N, got -1 N; give a larger one
    """

    def __init__(self, message: str = "", *, expected: str = "", got: str = "", remedy: str = "") -> None:
        """message: the whole sentence, where it quotes another program ("expected …, got: …; …") or has another form."""
        said = _SENTENCE.fullmatch(message)
        self.expected, self.got, self.remedy = said.groups() if said else (expected, got, remedy)
        super().__init__(printable_text(message or f"expected {expected}, got {got}; {remedy}"))

    def append(self, sentence: str) -> None:
        """Append what became known of the reason."""
        self.args = (printable_text(f"{self}; {sentence}"),)

    def __reduce__(self) -> tuple[object, ...]:
        """Return message and attributes for pickling: an error of a worker process arrives as it was raised.

        Exceptions are otherwise restored by a call of their class with the message alone, which classes of other arguments refuse.
        """
        return _restore_error, (type(self), self.args), self.__dict__


def _restore_error(kind: type[NinedtactError], message: tuple[object, ...]) -> NinedtactError:
    """Return an error of this class with this message, without a call of its constructor."""
    return kind.__new__(kind, *message)


class InputError(NinedtactError):
    """A value, an option, a design or an object cannot be used."""


class FileFormatError(NinedtactError):
    """A file or folder is missing, damaged, or of another format."""


class OutputError(NinedtactError):
    """A file or folder cannot be written, or not without overwriting something else."""


class MissingLibraryError(NinedtactError):
    """An optional library is not installed."""


class CameraError(NinedtactError):
    """A camera or another source of images is missing, lost, or delivers something else than expected."""


class DeviceError(NinedtactError):
    """A force/torque sensor, a graphics processor or a network port is missing, lost or refused."""


class CalibrationError(NinedtactError):
    """Images cannot calibrate a sensor, or a calibration or its reference image cannot be used."""


class ForceEstimationError(NinedtactError):
    """Force estimation, a force model or its training is impossible with what was given."""


class SimulationError(NinedtactError):
    """Contact mechanics or a simulated sensor cannot compute what was asked for."""


class DatasetError(NinedtactError):
    """A recording in progress or a data set cannot be built, checked or used as asked."""
