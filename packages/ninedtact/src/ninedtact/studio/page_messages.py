"""What browsers may send: the messages of viser's page, with values that the controls which they name can have.

viser applies any value to any control, and hands it on to what the control does. So each message is tested before viser gets it.
The messages are those of viser 1.1, which does not document them.
"""

from collections.abc import Callable
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from viser import (
    GuiButtonGroupHandle,
    GuiButtonHandle,
    GuiCheckboxHandle,
    GuiDropdownHandle,
    GuiNumberHandle,
    GuiSliderHandle,
    GuiTextHandle,
    GuiUploadButtonHandle,
    GuiVector2Handle,
)

FindControl = Callable[[str], Any]
"""Returns the control of a uuid; None where there is none, or none any more, whose messages viser ignores."""

_Number = Annotated[float, msgspec.Meta(ge=-1e9, le=1e9)]
_ShortText = Annotated[str, msgspec.Meta(max_length=200)]
_Vector = tuple[_Number, _Number, _Number]
_Pair = Annotated[list[_Number], msgspec.Meta(min_length=2, max_length=2)]
"""A list, because msgspec mistakes the limits of numbers in a union with a tuple of fixed length."""
_Quaternion = tuple[_Number, _Number, _Number, _Number]
MAX_UPLOAD_BYTES = 16_000_000
PART_BYTES = 512 * 1024
"""Size of the parts in which viser's page sends a file."""
_UploadSize = Annotated[int, msgspec.Meta(ge=0, le=MAX_UPLOAD_BYTES)]
_PartNumber = Annotated[int, msgspec.Meta(ge=0, le=MAX_UPLOAD_BYTES // PART_BYTES + 1)]
_Part = Annotated[bytes, msgspec.Meta(max_length=PART_BYTES)]


class _PageMessage(msgspec.Struct, tag_field="type", forbid_unknown_fields=True):
    """A message of viser's page."""


class _CameraMessage(_PageMessage, tag="ViewerCameraMessage"):
    """The pose of a browser's view, which viser's page sends."""

    wxyz: _Quaternion
    position: _Vector
    fov: _Number
    near: _Number
    far: _Number
    image_height: _Number
    image_width: _Number
    look_at: _Vector
    up_direction: _Vector


class _ControlMessage(_PageMessage, tag="GuiUpdateMessage"):
    """The new value of a button, a choice, a slider or a pair of numbers. viser would set any other attribute of it too."""

    uuid: _ShortText
    updates: Annotated[dict[Literal["value"], bool | _Number | _ShortText | _Pair], msgspec.Meta(min_length=1)]


class _CommandMessage(_PageMessage, tag="CommandTriggerMessage"):
    """A key that stands for a command, or a command that was chosen."""

    uuid: _ShortText


class _ClickMessage(_PageMessage, tag="ScenePointerMessage"):
    """A click on the scene in 3D."""

    event_type: Literal["click"]
    ray_origin: _Vector
    ray_direction: _Vector
    screen_pos: Annotated[list[tuple[_Number, _Number]], msgspec.Meta(max_length=2)]
    modifier: _ShortText | None


class _HandleMessage(_PageMessage, tag="TransformControlsUpdateMessage"):
    """The pose of the 3D handle."""

    name: _ShortText
    wxyz: _Quaternion
    position: _Vector
    owner: _ShortText = ""


class _HandleStartMessage(_PageMessage, tag="TransformControlsDragStartMessage"):
    """The 3D handle is grasped."""

    name: _ShortText
    owner: _ShortText = ""


class _HandleEndMessage(_PageMessage, tag="TransformControlsDragEndMessage"):
    """The 3D handle is let go."""

    name: _ShortText
    owner: _ShortText = ""


class _UploadMessage(_PageMessage, tag="FileTransferStartUpload"):
    """A file will follow in parts."""

    source_component_uuid: _ShortText
    transfer_uuid: _ShortText
    filename: _ShortText
    mime_type: _ShortText
    part_count: _PartNumber
    size_bytes: _UploadSize


class _PartMessage(_PageMessage, tag="FileTransferPart"):
    """One part of a file."""

    source_component_uuid: _ShortText
    transfer_uuid: _ShortText
    part_index: _PartNumber
    content: _Part


class _KeptMessage(_PageMessage, tag="LocalStorageGetItemResponseMessage"):
    """What the browser has kept for the page: its theme."""

    value: _ShortText | None
    error: _ShortText | None
    request_uuid: _ShortText


_PAGE_MESSAGES = msgspec.msgpack.Decoder(
    _CameraMessage
    | _ControlMessage
    | _CommandMessage
    | _ClickMessage
    | _HandleMessage
    | _HandleStartMessage
    | _HandleEndMessage
    | _UploadMessage
    | _PartMessage
    | _KeptMessage
)


def is_page_message(message: str | bytes, find_control: FindControl) -> bool:
    """Return whether a message is one that the controls of the page send, with a value of the kind that its control has.

    viser has more, which the page has no use for, such as a request to publish the page on the internet.
    """
    content = _decode(message)
    if isinstance(content, _ControlMessage):
        control = find_control(content.uuid)
        return control is None or _has_kind_of(control, content.updates["value"])
    if isinstance(content, _UploadMessage | _PartMessage):
        control = find_control(content.source_component_uuid)
        return control is None or isinstance(control, GuiUploadButtonHandle)
    return content is not None


def has_no_effect(message: str | bytes, find_control: FindControl) -> bool:
    """Return whether a message of the page names a control that cannot be used now, or has a number beyond its limits.

    A person may press a button in the moment in which it is hidden. Browsers send such numbers while a person types: the 1 of 15
    where 10 is the least. They correct the number in the end.
    """
    content = _decode(message)
    control = find_control(content.uuid) if isinstance(content, _ControlMessage) else None
    if not isinstance(content, _ControlMessage) or control is None:
        return False
    if not getattr(control, "visible", True) or getattr(control, "disabled", False):
        return True
    if not isinstance(control, _NUMERIC):
        return False
    least, most = (-np.inf if control.min is None else control.min), (np.inf if control.max is None else control.max)
    numbers = np.array(content.updates["value"])
    rounding = 0.0 if isinstance(control.value, int) else 0.5 * 10.0**-control.precision
    return not bool(((numbers >= np.array(least) - rounding) & (numbers <= np.array(most) + rounding)).all())


_NUMERIC = GuiNumberHandle, GuiSliderHandle, GuiVector2Handle
"""Controls with numbers, which browsers round to `precision` digits, and with the limits `min` and `max`."""


def _decode(message: str | bytes) -> _PageMessage | None:
    """Return a message of viser's page; None for anything else."""
    try:
        content: _PageMessage = _PAGE_MESSAGES.decode(message if isinstance(message, bytes) else b"")
    except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError):
        return None
    return content


def _has_kind_of(control: Any, value: bool | float | str | list[float]) -> bool:
    """Return whether a person could give a control this value, apart from the limits of numbers.

    Of a control that is not here, such as a bar of progress, no browser sends a value.
    """
    if isinstance(control, GuiButtonHandle):
        return value is True
    if isinstance(control, GuiButtonGroupHandle | GuiDropdownHandle):
        return value in control.options
    if isinstance(control, GuiVector2Handle):
        return isinstance(value, list)
    kinds = {GuiCheckboxHandle: bool, GuiTextHandle: str, GuiNumberHandle: float, GuiSliderHandle: float}
    return type(value) is kinds.get(type(control))
