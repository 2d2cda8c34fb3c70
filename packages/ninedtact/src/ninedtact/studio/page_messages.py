"""What browsers may send: the messages of viser's page that the controls of our pages send, with their sizes and ranges.

viser has more, which the page has no use for, such as a request to publish the page on the internet, and it applies any attribute
to any control. So each message is tested before viser gets it. The messages are those of viser 1.1, which does not document them.
"""

from typing import Annotated, Literal

import msgspec

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


class PageMessage(msgspec.Struct, tag_field="type", forbid_unknown_fields=True):
    """A message of viser's page."""


class CameraMessage(PageMessage, tag="ViewerCameraMessage"):
    """The pose of a browser's view. The first one says that the browser is ready."""

    wxyz: _Quaternion
    position: _Vector
    fov: _Number
    near: _Number
    far: _Number
    image_height: _Number
    image_width: _Number
    look_at: _Vector
    up_direction: _Vector


class _ControlMessage(PageMessage, tag="GuiUpdateMessage"):
    """The new value of a button, a choice, a slider or a pair of numbers. viser would set any other attribute of it too."""

    uuid: _ShortText
    updates: Annotated[dict[Literal["value"], bool | _Number | _ShortText | _Pair], msgspec.Meta(min_length=1)]


class _CommandMessage(PageMessage, tag="CommandTriggerMessage"):
    """A key that stands for a command, or a command that was chosen."""

    uuid: _ShortText


class _ClickMessage(PageMessage, tag="ScenePointerMessage"):
    """A click on the scene in 3D."""

    event_type: Literal["click"]
    ray_origin: _Vector
    ray_direction: _Vector
    screen_pos: Annotated[list[tuple[_Number, _Number]], msgspec.Meta(max_length=2)]
    modifier: _ShortText | None


class _HandleMessage(PageMessage, tag="TransformControlsUpdateMessage"):
    """The pose of the 3D handle."""

    name: _ShortText
    wxyz: _Quaternion
    position: _Vector
    owner: _ShortText = ""


class _HandleStartMessage(PageMessage, tag="TransformControlsDragStartMessage"):
    """The 3D handle is grasped."""

    name: _ShortText
    owner: _ShortText = ""


class _HandleEndMessage(PageMessage, tag="TransformControlsDragEndMessage"):
    """The 3D handle is let go."""

    name: _ShortText
    owner: _ShortText = ""


class _UploadMessage(PageMessage, tag="FileTransferStartUpload"):
    """A file will follow in parts."""

    source_component_uuid: _ShortText
    transfer_uuid: _ShortText
    filename: _ShortText
    mime_type: _ShortText
    part_count: _PartNumber
    size_bytes: _UploadSize


class _PartMessage(PageMessage, tag="FileTransferPart"):
    """One part of a file."""

    source_component_uuid: _ShortText
    transfer_uuid: _ShortText
    part_index: _PartNumber
    content: _Part


class _KeptMessage(PageMessage, tag="LocalStorageGetItemResponseMessage"):
    """What the browser has kept for the page: its theme."""

    value: _ShortText | None
    error: _ShortText | None
    request_uuid: _ShortText


_PAGE_MESSAGES = msgspec.msgpack.Decoder(
    CameraMessage
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


def decode_page_message(message: str | bytes) -> PageMessage | None:
    """Return a message that the controls of the page send; None for anything else."""
    try:
        content: PageMessage = _PAGE_MESSAGES.decode(message if isinstance(message, bytes) else b"")
    except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError):
        return None
    return content


class UploadTest:
    """Lets one client upload one file at a time, so that it costs one file of memory."""

    def __init__(self) -> None:
        self._transfer_uuid, self._missing_parts = "", 0

    def accepts(self, message: PageMessage | None) -> bool:
        """Return whether a message belongs to the upload that has begun, begins one after another has ended, or is no upload."""
        if isinstance(message, _UploadMessage):
            if self._missing_parts:
                return False
            self._transfer_uuid, self._missing_parts = message.transfer_uuid, message.part_count
        elif isinstance(message, _PartMessage):
            if message.transfer_uuid != self._transfer_uuid or not self._missing_parts:
                return False
            self._missing_parts -= 1
        return True
