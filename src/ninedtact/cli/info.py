"""ninedtact replay: what a recording holds."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from ninedtact.cli.terminal import print_result

if TYPE_CHECKING:
    from ninedtact.recording.summary import RecordingSummary


@dataclass(frozen=True)
class Replay:
    """Say what a recording holds: topics, rates, drops, gaps, pairs. To watch it: ninedtact live --source FILE."""

    recording: Annotated[Path, tyro.conf.Positional]
    """File that `ninedtact record` or `ninedtact collect` wrote, finished or cut short."""
    mend: bool = False
    """Finish a file that was cut short, so that other programs read it too."""
    json: bool = False
    """Print the figures as one JSON object."""

    def run(self) -> int:
        """Read it through its index, and print the figures."""
        from ninedtact.recording.errors import require_recording_libraries

        require_recording_libraries()
        from ninedtact.recording.mcap_repair import repair_recording
        from ninedtact.recording.reader import Recording
        from ninedtact.recording.summary import summarise_recording

        if self.mend:
            repair_recording(self.recording)
        with Recording(self.recording) as episode:
            found = summarise_recording(episode)
        return print_result(self.json, asdict(found), lines(self.recording, found))


def lines(path: Path, found: "RecordingSummary") -> Iterator[str]:
    """The figures for a person."""
    yield f"{path}: {found.seconds:.1f} s from {found.began}, {path.stat().st_size / 1e6:.1f} MB"
    yield f"  sensor {found.sensor}, images from {found.source}"
    if found.force_torque:
        yield f"  forces from {found.force_torque}"
    for topic in found.topics:
        rate = (
            ""
            if topic.rate_hz is None
            else f", {topic.rate_hz:.1f} Hz, {topic.gaps} gaps, longest {topic.longest_gap_ms:.0f} ms"
        )
        yield f"  {topic.messages:8d}  {topic.topic} ({topic.type}){rate}"
    yield f"  {found.dropped} images dropped"
    if found.pairs:
        yield f"  pairs: {', '.join(f'{number} {kind}' for kind, number in found.pairs.items())}"
    if not found.finished:
        yield (
            "  it was cut short: its last half second may be missing. It can be read as it is; 'ninedtact replay --mend' "
            "finishes it for other programs"
        )
