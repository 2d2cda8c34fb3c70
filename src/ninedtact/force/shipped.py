"""The force model that ships with the package; `ninedtact model make --recipe shipped` makes it anew."""

from pathlib import Path

SHIPPED_MODEL = Path(__file__).parent / "shipped.onnx"
