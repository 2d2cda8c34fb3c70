"""The compute device of a simulation: the processor, one contact at a time, or a torch device, many contacts at once."""

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from sys import platform
from typing import Any

from ninedtact.errors import DeviceError

_DRIVER_FILES = ("/dev/nvidiactl", "/dev/kfd", "/dev/dxg")
"""Files of GPU drivers (NVIDIA, AMD, and either under WSL). Only where one exists is torch, which takes seconds to load,
queried."""
_DEVICE_NAMES = "auto, cpu, cuda, cuda:N or torch-cpu"
_OUT_OF_MEMORY_WORDS = ("out of memory", "CUFFT_ALLOC_FAILED", "CUFFT_INTERNAL_ERROR")
"""Words in the error messages of torch and of cuFFT when memory runs out."""


class DeviceMissing(DeviceError):
    """Raised for a device that does not exist or cannot be used."""


@dataclass(frozen=True)
class Device:
    """Where contacts are solved and images are rendered."""

    name: str

    @property
    def kind(self) -> str:
        """The kind `cpu`, `torch-cpu` or `cuda`: kinds round differently, so a data set is made by one kind."""
        return self.name.partition(":")[0]

    @property
    def is_batched(self) -> bool:
        """Whether sessions advance together in batches."""
        return self.kind != "cpu"

    def zero_array(self) -> Any:
        """Return a torch zero on the device in single precision; raises `DeviceMissing` where its memory is full."""
        import torch

        try:
            return torch.zeros((), dtype=torch.float32, device="cpu" if self.kind == "torch-cpu" else self.name)
        except RuntimeError as error:
            if not is_out_of_memory(error):
                raise
            raise DeviceMissing(
                f"expected room in the memory of {self.name}, got none at all; end other programs that use it, or give "
                f"--device cpu"
            ) from error

    def release_memory(self) -> None:
        """Release the memory that torch keeps for later use."""
        if self.kind == "cuda":
            import torch

            torch.cuda.empty_cache()


def find_device(name: str) -> Device:
    """Return the device of this name; `auto` is a GPU where torch finds one, else the processor. Raises `DeviceMissing`."""
    kind, _, number = name.partition(":")
    if name == "auto":
        return Device("cuda" if _gpu_driver_exists() and find_spec("torch") and _gpu_count() else "cpu")
    if name == "cpu":
        return Device(name)
    if not (name in ("cuda", "torch-cpu") or (kind == "cuda" and number.isdecimal())):
        raise DeviceMissing(f"expected a device named {_DEVICE_NAMES}, got {name!r}; correct it")
    if find_spec("torch") is None:
        raise DeviceMissing(
            f"expected torch, which computes on {name}, got no such package; run pip install 'ninedtact[train]', or give "
            f"--device cpu"
        )
    if kind == "cuda":
        _require_gpu(name, int(number or 0))
    return Device(name)


def is_out_of_memory(error: RuntimeError) -> bool:
    """Return whether this error says that the device's memory is full."""
    import torch

    return isinstance(error, torch.OutOfMemoryError) or any(word in str(error) for word in _OUT_OF_MEMORY_WORDS)


def _require_gpu(name: str, number: int) -> None:
    """Refuse a GPU that torch does not find; raises `DeviceMissing`."""
    count = _gpu_count()
    if number >= count:
        found = f"{count}, cuda:0 to cuda:{count - 1}" if count else "none"
        raise DeviceMissing(
            f"expected {name}, a GPU that torch sees, got {found}; give --device cpu, or a torch that is built for the GPU "
            f"and its driver"
        )


def _gpu_driver_exists() -> bool:
    """Return whether a GPU may be there, so that loading torch is worthwhile."""
    return platform == "win32" or any(Path(driver).exists() for driver in _DRIVER_FILES)


def _gpu_count() -> int:
    """Return the number of GPUs that torch can use."""
    import torch

    return torch.cuda.device_count() if torch.cuda.is_available() else 0
