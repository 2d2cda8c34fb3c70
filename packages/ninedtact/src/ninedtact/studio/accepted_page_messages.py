"""What browsers may send: the messages of viser's page that the controls of our pages send, with their sizes and ranges.

viser has more, which the page has no use for, such as a request to publish the page on the internet, and it applies any attribute
to any control. So each message is tested before viser gets it. The messages are those of viser 1.1, which does not document them.
"""

from typing import Annotated, Any, Literal, Union

import msgspec
from msgspec import Meta

_Number = Annotated[float, Meta(ge=-1e9, le=1e9)]
_Text = Annotated[str, Meta(max_length=200)]
_Vector = tuple[_Number, _Number, _Number]
_Pair = Annotated[list[_Number], Meta(min_length=2, max_length=2)]
"""A list, because msgspec mistakes the limits of numbers in a union with a tuple of fixed length."""
_Quaternion = tuple[_Number, _Number, _Number, _Number]
MAX_UPLOAD_BYTES = 16_000_000
PART_BYTES = 512 * 1024
"""Size of the parts in which viser's page sends a file."""
_UploadSize = Annotated[int, Meta(ge=0, le=MAX_UPLOAD_BYTES)]
_PartNumber = Annotated[int, Meta(ge=0, le=MAX_UPLOAD_BYTES // PART_BYTES + 1)]
_Part = Annotated[bytes, Meta(max_length=PART_BYTES)]
_Value = Annotated[dict[Literal["value"], bool | _Number | _Text | _Pair], Meta(min_length=1)]
"""The new value of a control. viser would set any other attribute of it too."""
_Handle: dict[str, Any] = {"name": _Text, "owner": _Text}
_Transfer: dict[str, Any] = {"source_component_uuid": _Text, "transfer_uuid": _Text}


def _message(kind: str, **fields: Any) -> Any:
    return msgspec.defstruct(kind, [*fields.items()], tag_field="type", tag=kind, forbid_unknown_fields=True)


CameraMessage = _message(
    "ViewerCameraMessage",
    wxyz=_Quaternion,
    position=_Vector,
    look_at=_Vector,
    up_direction=_Vector,
    **dict.fromkeys(("fov", "near", "far", "image_height", "image_width"), _Number),
)
"""The pose of a browser's view. The first one says that the browser is ready."""
_UploadMessage = _message(
    "FileTransferStartUpload",
    **_Transfer,
    filename=_Text,
    mime_type=_Text,
    part_count=_PartNumber,
    size_bytes=_UploadSize,
)
_PartMessage = _message("FileTransferPart", **_Transfer, part_index=_PartNumber, content=_Part)
_OTHER_MESSAGES = (
    _message("GuiUpdateMessage", uuid=_Text, updates=_Value),
    _message("CommandTriggerMessage", uuid=_Text),
    _message(
        "ScenePointerMessage",
        event_type=Literal["click"],
        ray_origin=_Vector,
        ray_direction=_Vector,
        screen_pos=Annotated[list[tuple[_Number, _Number]], Meta(min_length=1, max_length=2)],
        modifier=_Text | None,
    ),
    _message("TransformControlsUpdateMessage", **_Handle, wxyz=_Quaternion, position=_Vector),
    _message("TransformControlsDragStartMessage", **_Handle),
    _message("TransformControlsDragEndMessage", **_Handle),
)
_DECODER: Any = msgspec.msgpack.Decoder(Union[CameraMessage, _UploadMessage, _PartMessage, *_OTHER_MESSAGES])


def decode_page_message(message: str | bytes) -> msgspec.Struct | None:
    """Return a message that the controls of the page send; None for anything else."""
    try:
        content: msgspec.Struct = _DECODER.decode(message if isinstance(message, bytes) else b"")
    except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError):
        return None
    return content


class OneUploadPerClient:
    """Lets one client upload one file at a time, so that it costs one file of memory."""

    def __init__(self) -> None:
        self._transfer_uuid, self._missing_parts, self._size, self._part_count = "", 0, 0, 0

    def accepts(self, message: Any) -> bool:
        """Return whether a message belongs to the upload that has begun, begins one after another has ended, or is no upload."""
        if isinstance(message, _UploadMessage):
            if self._missing_parts:
                return False
            if message.part_count != -(-message.size_bytes // PART_BYTES):
                return False
            self._transfer_uuid, self._missing_parts = message.transfer_uuid, message.part_count
            self._size, self._part_count = message.size_bytes, message.part_count
        elif isinstance(message, _PartMessage):
            if message.transfer_uuid != self._transfer_uuid or not self._missing_parts:
                return False
            index = self._part_count - self._missing_parts
            if message.part_index != index or len(message.content) != min(PART_BYTES, self._size - index * PART_BYTES):
                return False
            self._missing_parts -= 1
        return True
