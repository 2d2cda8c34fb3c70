"""Files of pairs, made by batches of sessions on one device.

Which sessions are one batch depends on the settings and on the size of a batch alone, never on what is there already:
arithmetic on a device rounds by the shape of its batch, and a job that goes on must end with the same bytes. So a batch of
which some files are missing is played again, and only those are written.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ninedtact.dataset.generation.bench import set_up
from ninedtact.dataset.generation.folder import path_of
from ninedtact.dataset.generation.session import Session
from ninedtact.dataset.generation.settings import DatasetSettings
from ninedtact.dataset.generation.table import write_pairs
from ninedtact.simulation.batched.device import Device
from ninedtact.simulation.batched.play import play
from ninedtact.simulation.batched.room import Room


@dataclass
class Making:
    """A data set on its way."""

    folder: Path
    settings: DatasetSettings
    device: Device
    at_once: int
    """Sessions of a batch, as whole files of them; a file that has more of them is a batch too."""
    threads: int
    tell: Callable[[str], None]
    room: Room | None = field(default=None, init=False)
    """Of the batch before."""

    def files(self, missing: Sequence[int]) -> Iterator[int]:
        """Write the missing files; how many pairs of them are new, time after time."""
        each = max(1, self.at_once // self.settings.sessions_per_file)
        for first in range(0, self.settings.files, each):
            group = range(first, min(first + each, self.settings.files))
            if wanted := [number for number in group if number in missing]:
                yield from self.batch(group, wanted)

    def batch(self, group: range, wanted: Sequence[int]) -> Iterator[int]:
        """One batch to its end; each file that is wanted is written when its last session is over."""
        room = self.room = self.next_room(group)
        files = {
            number: [self.session(session, room) for session in self.settings.sessions_of(number)] for number in group
        }
        waiting, known = set(wanted), 0
        for under_way in play([session for sessions in files.values() for session in sessions], room, self.threads):
            made = sum(len(session.made) for number in wanted for session in files[number])
            yield made - known
            known = made
            done = {number for number in waiting if under_way.isdisjoint(self.settings.sessions_of(number))}
            for number in sorted(done):
                pairs = [pair for session in files[number] for pair in session.made]
                write_pairs(path_of(self.folder, self.settings, number), pairs)
            waiting -= done

    def next_room(self, group: range) -> Room:
        """With the sensors of these files; those of the batch before stay set up, and so does the size that memory allowed."""
        before = dict(zip(self.room.numbers, self.room.benches, strict=True)) if self.room else {}
        sessions = (session for number in group for session in self.settings.sessions_of(number))
        numbers = sorted({session % self.settings.sensors for session in sessions})
        benches = [before.get(number) or set_up(number, self.settings) for number in numbers]
        at_once = self.room.at_once if self.room else self.at_once
        return Room(numbers, benches, self.device, at_once, self.tell)

    def session(self, number: int, room: Room) -> Session:
        """At its sensor."""
        return Session(number, self.settings, room.bench(number % self.settings.sensors))
