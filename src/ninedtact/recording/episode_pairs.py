"""What an episode's marks say, put together: image, wrench and untouched skin of each pair."""

from collections.abc import Iterator
from functools import cached_property
from itertools import groupby
from pathlib import Path

import numpy as np
from numpy import ndarray as Array

from ninedtact.recording.messages import EventKind, PairMark, Topic, image_of
from ninedtact.recording.saved_pair import KINDS, SavedPair, UntouchedSkin
from ninedtact.recording.stored import Episode
from ninedtact.recording.unreadable import RecordingUnreadable


def pairs_of(recording: Path | str) -> Iterator[SavedPair]:
    """The pairs of an episode that `ninedtact collect` wrote, finished or cut short, without undone contacts.

    Raises `CameraNotFound` where there is no file, and `RecordingUnreadable`.
    """
    with Episode(recording) as episode:
        yield from Collected(episode).pairs()


class Collected:
    """The pairs of an open episode."""

    def __init__(self, episode: Episode) -> None:
        self.episode = episode

    def pairs(self) -> Iterator[SavedPair]:
        """In the order of saving, without undone contacts; raises `RecordingUnreadable`."""
        for mark in self.marks:
            yield self.pair(mark)

    @cached_property
    def marks(self) -> list[PairMark]:
        """What was marked and not undone."""
        events = self.episode.events()
        undone = {event.subject for event in events if event.kind is EventKind.CONTACT_UNDONE}
        return [mark for mark in self.episode.pairs() if mark.contact not in undone]

    def pair(self, mark: PairMark) -> SavedPair:
        """One pair."""
        kinds = [kind for kind in KINDS if kind == mark.kind]
        if not kinds or mark.stamp_ns not in self.places or mark.untouched not in self.skins:
            raise RecordingUnreadable(
                f"expected a pair of {', '.join(KINDS)} with its images in {self.episode.path}, got a {mark.kind!r} at "
                f"{mark.stamp_ns} ns; restore the file from a copy"
            )
        return SavedPair(
            image=self.episode.frame(self.places[mark.stamp_ns]).image,
            wrench=mark.wrench,
            object=mark.object,
            contact=mark.contact,
            kind=kinds[0],
            time_ns=mark.stamp_ns,
            sensor=self.episode.session.sensor,
            untouched=self.skins[mark.untouched],
        )

    @cached_property
    def places(self) -> dict[int, np.void]:
        """Where the image of each stamp is."""
        stamps_ns = self.episode.stamps_ns(Topic.IMAGES).tolist()
        return dict(zip(stamps_ns, self.episode.places(Topic.IMAGES), strict=True))

    @cached_property
    def skins(self) -> dict[int, UntouchedSkin]:
        """The untouched skin of each tare."""
        messages = self.episode.messages(Topic.UNTOUCHED)
        return {
            number: UntouchedSkin(
                f"{self.episode.session.id}-u{number:03d}", tuple(locked(image_of(one.data)) for one in of_tare)
            )
            for number, of_tare in groupby(messages, key=lambda message: message.sequence)
        }


def locked(image: Array) -> Array:
    """The same image, not to be written to."""
    image.flags.writeable = False
    return image
