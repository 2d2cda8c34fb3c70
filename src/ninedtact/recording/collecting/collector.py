"""Images and samples in, saved pairs out.

image ──waits until what comes after it is known──▶ wrench at its moment ──trusted?──▶ worth keeping? ──▶ episode

Everything goes by stamps, nothing by the clock on the wall: what is collected live, from a twin or from a recording is collected
by the same steps.
"""

from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import count

import numpy as np

from ninedtact.capture.force_torque.refusals import WrenchUntrusted
from ninedtact.capture.sampling_rule import SamplingRule
from ninedtact.quantities import Frame, Wrench
from ninedtact.recording.collecting.counters import Counters, Saved
from ninedtact.recording.collecting.moment import Moment
from ninedtact.recording.collecting.rest import Rest
from ninedtact.recording.collecting.settings import CollectSettings
from ninedtact.recording.collecting.tare import Taring, Untouched
from ninedtact.recording.collecting.trust import FAULTS, ClockTrust, Fault, SampleTrust
from ninedtact.recording.collecting.worth import Worth
from ninedtact.recording.collecting.wrench_track import WrenchTrack
from ninedtact.recording.episode import EpisodeWriter
from ninedtact.recording.listening import Heard
from ninedtact.recording.messages import Event, EventKind, PairMark, Topic
from ninedtact.recording.saved_pair import NOTHING

TOPICS = (Topic.IMAGES, Topic.UNTOUCHED, Topic.MEASURED, Topic.PAIRS)
PATIENCE_NS = 1_000_000_000
"""After which an image no longer waits for samples."""


@dataclass
class Collector:
    """Saves pairs into an open episode. Starts with a tare."""

    episode: EpisodeWriter
    settings: CollectSettings = CollectSettings()
    objects: Iterator[str] = field(default_factory=lambda: (f"object_{number:03d}" for number in count(1)))
    """Names of the objects, in turn."""
    rng: np.random.Generator = field(default_factory=np.random.default_rng)

    def __post_init__(self) -> None:
        self.worth, self.rest = Worth(self.settings, SamplingRule(self.settings.rule, self.rng)), Rest(self.settings)
        self.counters = Counters(self.settings.rule.ranges)
        self.refused: Counter[Fault] = Counter()
        """Images that were not saved because something is wrong."""
        self.told: Fault | None = None
        """What is wrong now."""
        self.now: Moment | None = None
        """The newest moment that was decided."""
        self.words = ""
        """What a refused sample says of itself."""
        self.track = WrenchTrack()
        self.trust = SampleTrust(int(self.settings.trust.frozen_ms * 1e6))
        self.clocks = ClockTrust(self.settings.tolerance_ms), ClockTrust(self.settings.tolerance_ms)
        self.pending: deque[tuple[Frame, str]] = deque()
        """Images that wait for what comes after them, and the object in the hand."""
        self.taring: Taring | None = Taring(0, self.settings)
        self.untouched: Untouched | None = None
        self.object = ""
        self.newest_ns = 0
        self._object_decided = ""

    def hear(self, heard: Heard[Frame | Wrench | WrenchUntrusted]) -> None:
        """An image, a sample, or a sample that must not be used; images and samples each in the order of their stamps."""
        if isinstance(heard.item, Frame):
            self.clocks[0].note(heard.item.stamp_ns, heard.at_ns)
            self._see(heard.item)
        elif isinstance(heard.item, Wrench):
            self.clocks[1].note(heard.item.stamp_ns, heard.at_ns)
            self._feel(heard.item)
        else:
            self.trust.refuse(heard.item)
            self.words = str(heard.item)

    def _see(self, frame: Frame) -> None:
        self.newest_ns = max(self.newest_ns, frame.stamp_ns)
        if self.taring is not None:
            self.taring.see(frame)
            self._end_tare()
        else:
            self.pending.append((frame, self.object))
            self._decide_pending()

    def _feel(self, sample: Wrench) -> None:
        wrench = sample.about(np.zeros(3))
        self.episode.measured(wrench)
        if not self.trust.takes(wrench):
            return
        self.track.add(wrench)
        if self.taring is not None:
            self.taring.feel(wrench)
        else:
            self._decide_pending()

    def tare(self) -> None:
        """Weigh the untouched skin anew, and take its image."""
        self.pending.clear()
        self.taring = Taring(self.untouched.number + 1 if self.untouched else 0, self.settings, self.untouched)

    def next_object(self, name: str | None = None, at_ns: int | None = None) -> None:
        """Another object from now on: the named one, else the next in turn. at_ns: when, if not now."""
        self.object = name or next(self.objects)
        self.episode.event(Event(at_ns or self.newest_ns, EventKind.OBJECT, self.object))

    def undo(self) -> str:
        """Take back the newest contact that has pairs; what was done, in words."""
        contact = self.counters.last_contact
        if contact is None:
            return "nothing to undo"
        pairs = self.counters.undo(contact)
        self.worth.begin_contact()
        self.episode.event(Event(self.newest_ns, EventKind.CONTACT_UNDONE, contact))
        return f"undone: the last contact with its {pairs} pairs"

    def end(self) -> None:
        """No more comes: decide what still waits."""
        while self.pending:
            self._decide(*self.pending.popleft())

    def _end_tare(self) -> None:
        assert self.taring is not None
        found = self.taring.untouched()
        if found is None:
            return
        self.untouched, self.taring = found, None
        for frame in found.frames:
            self.episode.untouched(frame, found.number)
        zero = " ".join(f"{number:.6g}" for number in found.zero)
        self.episode.event(Event(self.newest_ns, EventKind.TARED, str(found.number), zero))
        self.trust.at_rest()
        self.rest.begin()
        if not self.object:
            self.next_object()

    def _decide_pending(self) -> None:
        while self.pending:
            at_ns = self._moment_ns(self.pending[0][0])
            if self.track.newest_ns < at_ns + self.settings.hindsight_ns and self.newest_ns < at_ns + PATIENCE_NS:
                return
            self._decide(*self.pending.popleft())

    def _moment_ns(self, frame: Frame) -> int:
        return frame.stamp_ns - int(self.settings.camera_late_ms * 1e6)

    def _decide(self, frame: Frame, name: str) -> None:
        assert self.untouched is not None
        if name != self._object_decided:
            self._object_decided = name
            self.worth.begin_contact()
        at_ns = self._moment_ns(frame)
        fault, wrench = self._fault_at(at_ns), self.track.at(at_ns)
        if wrench is not None and fault in (None, Fault.SHIFTED):
            change = self.untouched.seen.change(frame.image)
            self.now = Moment(frame, self.untouched.taken_off(wrench), change)
            fault = self._fault_of(self.now, fault)
            if fault is None:
                self._save(self.now)
        self._tell(fault)

    def _fault_at(self, at_ns: int) -> Fault | None:
        if not all(clock.keeps for clock in self.clocks):
            return Fault.CLOCK
        tolerance_ns = int(self.settings.tolerance_ms * 1e6)
        if fault := self.trust.fault(at_ns - tolerance_ns, at_ns + tolerance_ns):
            return fault
        return Fault.UNPAIRED if self.track.distance_ns(at_ns) > tolerance_ns else None

    def _fault_of(self, moment: Moment, fault: Fault | None) -> Fault | None:
        if self.rest.sees(moment):
            self.trust.at_rest()
            return None
        return Fault.NOT_AT_REST if self.rest.has_drifted else fault

    def _save(self, moment: Moment) -> None:
        kind = self.worth.of(moment, self.counters)
        if kind is None:
            return
        frame, name = moment.frame, NOTHING if kind == "no_contact" else self._object_decided
        contact = f"{self.episode.session.id}-{self.worth.contact:05d}"
        assert self.untouched is not None
        numbers = {"image": frame.index, "untouched": self.untouched.number}
        self.episode.kept_image(frame)
        self.episode.pair(
            PairMark(frame.stamp_ns, **numbers, object=name, contact=contact, kind=kind, wrench=moment.wrench)
        )
        self.counters.add(Saved(kind, name, contact, moment.wrench.six))

    def _tell(self, fault: Fault | None) -> None:
        if fault is not None:
            self.refused[fault] += 1
            if fault is not self.told:
                self.episode.event(Event(self.newest_ns, EventKind.REMARK, fault.name.lower(), self.sentence(fault)))
        self.told = fault

    def sentence(self, fault: Fault) -> str:
        """What to tell a person of it."""
        if fault in FAULTS.values():
            return self.words or fault.value
        if fault is Fault.UNPAIRED:
            return f"{fault.value} (tolerance {self.settings.tolerance_ms:g} ms)"
        return fault.value
