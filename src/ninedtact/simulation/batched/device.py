"""On what data sets are made: the processor, one contact at a time, or a device of torch's, many at once."""

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from sys import platform
from typing import Any

from ninedtact.errors import DeviceError

DRIVERS = ("/dev/nvidiactl", "/dev/kfd", "/dev/dxg")
"""One of these is where a GPU can be used (NVIDIA, AMD, and either under WSL): torch, which takes seconds to load, is asked
only then."""
NAMES = "auto, cpu, cuda, cuda:N or torch-cpu"
FULL = ("out of memory", "CUFFT_ALLOC_FAILED", "CUFFT_INTERNAL_ERROR")
"""What errors say where memory ran out; cuFFT has names of its own for it."""


class DeviceMissing(DeviceError):
    """A device that is not there."""


@dataclass(frozen=True)
class Device:
    """Where contacts are solved and drawn."""

    name: str

    @property
    def kind(self) -> str:
        """`cpu`, `torch-cpu` or `cuda`: kinds round differently, so a data set is of one."""
        return self.name.partition(":")[0]

    @property
    def many(self) -> bool:
        """Whether sessions are made together, in batches."""
        return self.kind != "cpu"

    def like(self) -> Any:
        """A torch array there, in single precision; raises `DeviceMissing` where there is no room for one number."""
        import torch

        try:
            return torch.zeros((), dtype=torch.float32, device="cpu" if self.kind == "torch-cpu" else self.name)
        except RuntimeError as trouble:
            if not ran_out(trouble):
                raise
            raise DeviceMissing(
                f"expected room in the memory of {self.name}, got none at all; end what uses it, or give --device cpu"
            ) from trouble

    def freed(self) -> None:
        """Give back what torch keeps for later."""
        if self.kind == "cuda":
            import torch

            torch.cuda.empty_cache()


def device_named(name: str) -> Device:
    """The device of this name, if it is there; `auto` is a GPU where torch sees one. Raises `DeviceMissing`."""
    kind, _, number = name.partition(":")
    if name == "auto":
        return Device("cuda" if driver_there() and find_spec("torch") and gpus() else "cpu")
    if name == "cpu":
        return Device(name)
    if not (name in ("cuda", "torch-cpu") or (kind == "cuda" and number.isdecimal())):
        raise DeviceMissing(f"expected a device named {NAMES}, got {name!r}; correct it")
    if find_spec("torch") is None:
        raise DeviceMissing(
            f"expected torch, which works on {name}, got no such package; run pip install 'ninedtact[train]', or give "
            f"--device cpu"
        )
    if kind == "cuda":
        require_gpu(name, int(number or 0))
    return Device(name)


def require_gpu(name: str, number: int) -> None:
    """Refuse a GPU that torch does not see; raises `DeviceMissing`."""
    there = gpus()
    if number >= there:
        seen = f"{there}, cuda:0 to cuda:{there - 1}" if there else "none"
        raise DeviceMissing(
            f"expected {name}, a GPU that torch sees, got {seen}; give --device cpu, or a torch that is built for the GPU "
            f"and its driver"
        )


def driver_there() -> bool:
    """Whether it is worth asking torch for a GPU."""
    return platform == "win32" or any(Path(driver).exists() for driver in DRIVERS)


def gpus() -> int:
    """How many torch sees."""
    import torch

    return torch.cuda.device_count() if torch.cuda.is_available() else 0


def ran_out(trouble: RuntimeError) -> bool:
    """Whether this says that the device's memory is full."""
    import torch

    return isinstance(trouble, torch.OutOfMemoryError) or any(word in str(trouble) for word in FULL)
