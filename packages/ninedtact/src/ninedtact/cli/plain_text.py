"""Output that a terminal, pipe or file can take whose encoding lacks some of the characters that the commands print."""

import codecs
import sys
import unicodedata

_ERRORS = "ninedtact.plain_text"
_SPELLED = {
    "±": "+/-", "×": "x", "·": "*", "÷": "/", "−": "-", "–": "-", "—": "-", "‐": "-", "→": "->", "▶": ">", "≥": ">=", "≤": "<=",
    "≈": "~", "°": " deg", "√": "sqrt", "∝": "~", "⌀": "diameter ", "‖": "|", "✓": "ok", "✗": "x", "“": '"', "”": '"', "‘": "'",
    "’": "'", "§": "section ", "├": "|", "└": "`", "│": "|", "─": "-", "■": "#", "█": "#", "▇": "#", "▆": "=", "▅": "=", "▄": "=",
    "▃": "-", "▂": "_", "▁": "_", "∇": "grad ", "⊗": "x", "ℓ": "l", "µ": "u", "⁄": "/",
    "•": "*", "←": "<-", "↑": "^", "↓": "v", "∞": "inf", "≠": "!=", "∑": "sum", "∂": "d",
}  # fmt: skip
"""Words and signs of ASCII for characters that no decomposition spells."""


def spell_in_ascii(text: str) -> str:
    """Return a text in ASCII: `2.1 ± 0.3 mm²` as `2.1 +/- 0.3 mm2`. What has no spelling becomes an escape such as `\\u4e2d`."""
    return "".join(map(_spell_character, text))


def _spell_character(character: str) -> str:
    if character.isascii():
        return character
    if character in _SPELLED:
        return _SPELLED[character]
    name = unicodedata.name(character, "")
    if name.startswith("GREEK"):
        return name.split(" WITH ")[0].rsplit(maxsplit=1)[-1].lower()
    if name.startswith("BOX DRAWINGS"):
        return _spell_box_line(name)
    plain = unicodedata.normalize("NFKD", character)
    kept = "".join(part for part in plain if not unicodedata.combining(part))
    if plain != character or unicodedata.combining(character):
        return spell_in_ascii(kept)
    return character.encode("ascii", "backslashreplace").decode()


def _spell_box_line(name: str) -> str:
    if "HORIZONTAL" in name:
        return "+" if "VERTICAL" in name else "-"
    return "|" if "VERTICAL" in name else "+"


def _replace_unencodable(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return spell_in_ascii(error.object[error.start : error.end]), error.end


def spell_what_outputs_cannot_print() -> None:
    """Let standard output and standard error spell characters that their encoding lacks, instead of raising an error."""
    codecs.register_error(_ERRORS, _replace_unencodable)
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)  # a program may have put any object there
        if reconfigure is not None:
            reconfigure(errors=_ERRORS)


def prints_unicode(stream: object) -> bool:
    """Return whether a stream prints every character as it is."""
    return (getattr(stream, "encoding", None) or "utf-8").lower().replace("-", "").startswith("utf")
