"""Which cameras this machine has, read from the kernel's own files (Linux)."""

import getpass
import os
from dataclasses import dataclass
from pathlib import Path

KERNEL_LIST = Path("/sys/class/video4linux")
QUERY_CAPABILITIES = 0x80685600
"""VIDIOC_QUERYCAP, https://docs.kernel.org/userspace-api/media/v4l/vidioc-querycap.html."""
DEVICE_CAPABILITIES = slice(88, 92)
VIDEO_CAPTURE = 0x00000001 | 0x00001000
"""Single-planar or multi-planar."""


@dataclass(frozen=True)
class CameraDevice:
    """A camera as the kernel lists it."""

    path: str
    name: str


def list_cameras(kernel_list: Path = KERNEL_LIST, device_folder: Path = Path("/dev")) -> list[CameraDevice]:
    """All devices that can deliver images, in the order of their numbers; none where the system is not Linux."""
    nodes = sorted(kernel_list.glob("video*"), key=lambda node: (len(node.name), node.name))
    found = [CameraDevice(str(device_folder / node.name), _name_of(node)) for node in nodes]
    return [device for device in found if _captures(device.path)]


def why_closed(device: int | str) -> str:
    """Why a device does not open, as words that follow "got"."""
    path = Path(f"/dev/video{device}" if isinstance(device, int) else device)
    if not path.exists():
        others = ", ".join(camera.path for camera in list_cameras()) or "no camera at all"
        return f"no device {path}; plug it in (this machine has {others}), or name it with --source"
    if not os.access(path, os.R_OK | os.W_OK):
        return f"no permission for {path}; {permission_remedy()}"
    return f"a refusal from {path}; close the other program that uses it, or name another device"


def permission_remedy() -> str:
    """How a person gets to open cameras."""
    return f"run `sudo usermod -aG video {_user()}` and log in again"


def _name_of(node: Path) -> str:
    try:
        return (node / "name").read_text().strip()
    except OSError:
        return "unnamed"


def _captures(path: str) -> bool:
    """Whether a device delivers images; a UVC camera also lists one that delivers only metadata.

    A device that may not be asked counts as a camera: the user must hear of the missing permission.
    """
    import fcntl  # not on Windows, where no device gets this far

    answer = bytearray(104)
    try:
        handle = os.open(path, os.O_RDWR | os.O_NONBLOCK)
        try:
            fcntl.ioctl(handle, QUERY_CAPABILITIES, answer)
        finally:
            os.close(handle)
    except OSError:
        return True
    return bool(int.from_bytes(answer[DEVICE_CAPABILITIES], "little") & VIDEO_CAPTURE)


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return "$USER"
