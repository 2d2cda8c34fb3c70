"""Mutations of files: numbers of a text exchanged, bytes flipped, files cut short, something else in place of a file.

A mutation is a name in words and the new content of one file, or the kind of thing that is put in its place. The same seed gives
the same mutations.
"""

import io
import json
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

Place = Literal["file", "directory", "fifo", "device", "unreadable", "missing"]
PLACES: tuple[Place, ...] = ("directory", "fifo", "device", "unreadable", "missing")


@dataclass(frozen=True)
class Mutation:
    """What is put in place of one file: other bytes in a part of it, or something that is no file."""

    name: str
    part: bytes = b""
    start: int = 0
    stop: int | None = None
    """The part takes the place of the bytes from start to stop, by default of all of them."""
    place: Place = "file"

    def put(self, path: Path, content: bytes) -> None:
        """Put it at a path at which nothing is; content: that of the unmutated file."""
        if self.place == "directory":
            path.mkdir()
        elif self.place == "fifo":
            os.mkfifo(path)
        elif self.place == "device":
            path.symlink_to("/dev/zero")
        elif self.place != "missing":
            end = b"" if self.stop is None else content[self.stop :]
            path.write_bytes(content[: self.start] + self.part + end)
            if self.place == "unreadable":
                path.chmod(0)


def remove(path: Path) -> None:
    """Remove what `Mutation.put` has put at a path."""
    if path.is_dir() and not path.is_symlink():
        path.rmdir()
    else:
        path.unlink(missing_ok=True)


_NUMBER = re.compile(r"(?<![\w.\"/-])-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?(?![\w.\"/:-])")
"""A number of TOML, JSON or CSV that is no part of a word, a path or a date."""


def _other_numbers(text: str, dialect: str) -> Iterator[tuple[str, str]]:
    """Yield what stands in place of a number, with its name."""
    value = float(text)
    words = {"json": ("NaN", "Infinity", "-Infinity"), "toml": ("nan", "inf", "-inf"), "csv": ("nan", "inf", "-inf")}
    yield from zip(("NaN", "inf", "-inf"), words[dialect], strict=True)
    whole = "." not in text and "e" not in text.lower()
    changes = (("0", 0.0), ("negative", -value or -1.0), ("x 10", value * 10), ("/ 10", value / 10))
    for name, other in (*changes, ("x 1.3", value * 1.3), ("x 1e6", value * 1e6), ("x 1e-9", value * 1e-9)):
        yield name, str(int(other)) if whole and other == int(other) else repr(float(other))
    yield "huge", "1" + "0" * 30
    yield "text", '"many"'
    yield "boolean", "true"
    yield "list", "[1.0, 2.0]" if dialect != "csv" else "1.0;2.0"


def text_mutations(content: bytes, count: int, seed: int, dialect: str = "toml") -> list[Mutation]:
    """Return this many mutations of a text: four fifths of its numbers, the rest of its lines and bytes.

    Every mutated number comes once before any number comes a second time.
    """
    rng = np.random.default_rng(seed)
    text = content.decode()
    places = list(_NUMBER.finditer(text))
    of_place = [[*_other_numbers(place[0], dialect)] for place in places]
    for others in of_place:
        rng.shuffle(others)
    numbers = []
    order = rng.permutation(len(places)) if places else []
    while len(numbers) < count * 4 // 5 and any(of_place):
        for at in order:
            if of_place[at]:
                name, other = of_place[at].pop()
                start, stop = (len(text[:to].encode()) for to in places[at].span())
                line = text.count("\n", 0, places[at].start()) + 1
                numbers.append(Mutation(f"line {line}: {places[at][0]} becomes {name}", other.encode(), start, stop))
    numbers = numbers[: count * 4 // 5]
    rest = count - len(numbers)
    lines = _line_mutations(text, rest // 2, rng)
    return [*numbers, *lines, *byte_mutations(content, rest - rest // 2, seed + 1)]


def _line_mutations(text: str, count: int, rng: np.random.Generator) -> Iterator[Mutation]:
    """Yield texts with a line left out, repeated, renamed or added."""
    lines = text.splitlines(keepends=True)
    for number in range(count):
        at = int(rng.integers(len(lines)))
        change = ("left out", "repeated", "renamed", "added")[number % 4]
        line = lines[at]
        new = {"left out": "", "repeated": line * 2, "renamed": f"x{line}", "added": f"{line}surplus = 1\n"}[change]
        yield Mutation(f"line {at + 1} {change}", "".join([*lines[:at], new, *lines[at + 1 :]]).encode())


def byte_mutations(content: bytes, count: int, seed: int) -> list[Mutation]:
    """Return this many mutations of bytes: flipped bits, cuts, blocks of zeros, inserted, exchanged and appended bytes."""
    rng = np.random.default_rng(seed)
    found = [Mutation("empty", b"")] if count else []
    while len(found) < count:
        at, size = int(rng.integers(len(content))), int(rng.integers(1, 64))
        kind = ("flip", "flip", "flip", "cut", "zeros", "insert", "exchange", "append")[len(found) % 8]
        end = min(at + size, len(content))
        new, stop = {
            "flip": (bytes([content[at] ^ 1 << int(rng.integers(8))]), at + 1),
            "cut": (b"", len(content)),
            "zeros": (bytes(end - at), end),
            "insert": (rng.bytes(size), at),
            "exchange": (rng.bytes(end - at), end),
            "append": (content[at:] + rng.bytes(size), len(content)),
        }[kind]
        found.append(Mutation(f"{kind} at byte {at}", new, at, stop))
    return found


def place_mutations(places: Sequence[Place]) -> list[Mutation]:
    """Return something else in place of a file: a folder, a pipe, a device, a file without permission, nothing."""
    return [Mutation(place, stop=0, place=place) for place in places]


def array_mutations(content: bytes, count: int, seed: int) -> list[Mutation]:
    """Return this many mutations of a .npy file: of its numbers, its shape, its type and its bytes."""
    rng, array = np.random.default_rng(seed), np.load(io.BytesIO(content))
    one = array.astype(float)
    found = []
    for name, value in (("NaN", np.nan), ("inf", np.inf), ("negative", -1e3), ("huge", 1e12)):
        changed = one.copy()
        changed.flat[int(rng.integers(one.size))] = value
        found.append((f"one number becomes {name}", changed))
    found += [(f"all numbers become {value:g}", np.full_like(one, value)) for value in (0, 1, -1, 1e6)]
    found += [(f"x {factor:g}", (one * factor)) for factor in (10, 0.1, 1.3, -1, 1e6)]
    found += [("the first for all", np.full_like(array, array.flat[0])), ("reversed", np.flip(array))]
    found += [("shuffled", rng.permutation(array.ravel()).reshape(array.shape)), ("transposed", array.T.copy())]
    found += [("half of it", array[: len(array) // 2]), ("no number", array[:0]), ("one number", array.ravel()[:1])]
    found += [
        ("boolean", array > 0),
        ("complex", array * 1j),
        ("text", array.astype(str)),
        ("8 bits", array.astype("i1")),
    ]
    middle = (one.min() + one.max()) / 2
    found += [
        ("8 bits without a sign", array.astype("u1")),
        ("two values", np.where(one > middle, one.max(), one.min())),
        ("half of it constant", np.minimum(one, middle)),
        ("shifted", np.clip(one + np.floor((one.max() - one.min()) / 6), one.min(), one.max())),
        ("the first few", array[: max(len(array) // 20, 1)]),
    ]
    found += [("one dimension more", array[None]), ("twice", np.concatenate([array, array]))]
    changed = [Mutation(name, _npy(value)) for name, value in found]
    return [*changed[:count], *byte_mutations(content, max(count - len(changed), 0), seed)]


def _npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=False)
    return stream.getvalue()


def model_card_mutations(content: bytes, key: str, count: int, seed: int) -> list[Mutation]:
    """Return this many mutations of an ONNX file: three quarters of the numbers of its card, the rest of its bytes."""
    import onnx

    cards = []
    model = onnx.load_from_string(content)
    card = next(entry for entry in model.metadata_props if entry.key == key)
    text = json.dumps(json.loads(card.value), indent=1).encode()
    for mutation in text_mutations(text, count * 3 // 4, seed, "json"):
        end = b"" if mutation.stop is None else text[mutation.stop :]
        try:
            card.value = (text[: mutation.start] + mutation.part + end).decode()
        except UnicodeDecodeError:
            continue
        cards.append(Mutation(f"card, {mutation.name}", model.SerializeToString()))
    return [*cards, *byte_mutations(content, count - len(cards), seed)]
