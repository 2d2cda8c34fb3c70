"""A split on disk: JSON, an id a line, so that two can be compared."""

from collections import Counter
from dataclasses import asdict
from pathlib import Path

import msgspec

from ninedtact.atomic_write import write_file_atomically
from ninedtact.force.splits import Split, SplitUnfit

FORMAT = 1


def write_split(path: Path | str, split: Split) -> None:
    """Whole or not at all; raises `FileNotWritten`."""
    table = {"format": FORMAT, **asdict(split)}
    write_file_atomically(path, msgspec.json.format(msgspec.json.encode(table), indent=1), b"\n")


def read_split(path: Path | str) -> Split:
    """What `write_split` wrote, checked; raises `SplitUnfit`."""
    try:
        content = Path(path).read_bytes()
        version = msgspec.json.decode(content, type=dict[str, object]).get("format")
        read = msgspec.json.decode(content, type=Split)
    except (OSError, msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as trouble:
        raise SplitUnfit(
            f"expected a split in {path}, got: {trouble}; give a file that this program wrote, or split again"
        ) from trouble
    counts = Counter([*read.train, *read.test, *read.left_out])
    repeated = counts.total() - len(counts)
    if version != FORMAT or not read.train or not read.test or repeated:
        raise SplitUnfit(
            f"expected a split in {path}, format {FORMAT}, with pairs to train and to test, each once, got format {version} with "
            f"{len(read.train)} to train, {len(read.test)} to test and {repeated} repeated; split again"
        )
    return read
