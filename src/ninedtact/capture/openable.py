"""What all devices have in common: they are opened, and closed however their use ends."""

from abc import ABC, abstractmethod
from types import TracebackType
from typing import TypeVar

Opened = TypeVar("Opened", bound="Openable")


class Openable(ABC):
    """Anything that holds a device from `open` to `close`. The constructor touches none; opening is all or nothing."""

    name: str
    """What to call it in front of a person; never holds a password."""

    @abstractmethod
    def open(self) -> None:
        """Open, or raise and leave nothing open. Opening what is open does nothing."""

    @abstractmethod
    def close(self) -> None:
        """Release the device. Any thread may call it, any number of times; it waits for a read in progress."""

    def __enter__(self: Opened) -> Opened:
        self.open()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()
