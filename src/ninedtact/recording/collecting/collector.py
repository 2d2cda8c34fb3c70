"""The last seconds of a force/torque sensor, and its wrench at any moment of them.

Images and samples in, saved pairs out.

image ──waits until what comes after it is known──▶ wrench at its moment ──trusted?──▶ worth keeping? ──▶ episode

Everything goes by stamps, nothing by the clock on the wall: what is collected live, from a twin or from a recording is collected
by the same steps.
"""

from bisect import bisect_left
from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import count

import numpy as np

from ninedtact.capture.sampling_rule import SamplingRule
from ninedtact.capture.wrench_source import WrenchSampleRejected
from ninedtact.quantities import Frame, Wrench
from ninedtact.recording.collecting.pair_counts import CountedPair, PairCounts
from ninedtact.recording.collecting.pair_selection import PairCandidate, PairSelector, ZeroDriftMonitor
from ninedtact.recording.collecting.sample_faults import FAULTS, ClockDriftMonitor, SampleFault, SampleFaultTracker
from ninedtact.recording.collecting.settings import CollectSettings
from ninedtact.recording.collecting.tare import TareInProgress, TareReference
from ninedtact.recording.merge_streams import Arrival
from ninedtact.recording.ros_messages import EventKind, PairLabel, RecordingEvent, Topic
from ninedtact.recording.saved_pairs import NO_OBJECT
from ninedtact.recording.writer import RecordingWriter

KEPT_NS = 5_000_000_000


class WrenchHistory:
    """Samples about the skin's centre in the order of their stamps."""

    def __init__(self) -> None:
        self.samples: deque[Wrench] = deque()

    def add(self, wrench: Wrench) -> None:
        """A sample younger than all before."""
        self.samples.append(wrench)
        while wrench.stamp_ns - self.samples[0].stamp_ns > KEPT_NS:
            self.samples.popleft()

    @property
    def newest_ns(self) -> int:
        """Stamp of the newest sample, 0 before the first."""
        return self.samples[-1].stamp_ns if self.samples else 0

    def since(self, from_ns: int) -> Iterator[Wrench]:
        """All samples that are not older."""
        return (wrench for wrench in self.samples if wrench.stamp_ns >= from_ns)

    def distance_ns(self, at_ns: int) -> float:
        """How far the farther of the two samples around a moment is from it; infinite where one is missing."""
        before, after = self._around(at_ns)
        if before is None or after is None:
            return np.inf
        return max(at_ns - before.stamp_ns, after.stamp_ns - at_ns)

    def at(self, at_ns: int) -> Wrench | None:
        """The wrench at a moment, straight between the samples around it; None where one is missing."""
        before, after = self._around(at_ns)
        if before is None or after is None:
            return None
        part = (at_ns - before.stamp_ns) / max(after.stamp_ns - before.stamp_ns, 1)
        force_n, torque_nm = ((1 - part) * before.six + part * after.six).reshape(2, 3)
        return Wrench(force_n, torque_nm, stamp_ns=at_ns)

    def _around(self, at_ns: int) -> tuple[Wrench | None, Wrench | None]:
        after = bisect_left(self.samples, at_ns, key=lambda wrench: wrench.stamp_ns)
        if after < len(self.samples) and self.samples[after].stamp_ns == at_ns:
            return self.samples[after], self.samples[after]
        before = self.samples[after - 1] if after > 0 else None
        return before, self.samples[after] if after < len(self.samples) else None


COLLECTED_TOPICS = (Topic.IMAGES, Topic.UNTOUCHED, Topic.MEASURED, Topic.PAIRS)
PATIENCE_NS = 1_000_000_000
"""After which an image no longer waits for samples."""


@dataclass
class Collector:
    """Saves pairs into an open episode. Starts with a tare."""

    episode: RecordingWriter
    settings: CollectSettings = CollectSettings()
    objects: Iterator[str] = field(default_factory=lambda: (f"object_{number:03d}" for number in count(1)))
    """Names of the objects, in turn."""
    rng: np.random.Generator = field(default_factory=np.random.default_rng)

    def __post_init__(self) -> None:
        self.worth, self.rest = (
            PairSelector(self.settings, SamplingRule(self.settings.rule, self.rng)),
            ZeroDriftMonitor(self.settings),
        )
        self.counters = PairCounts(self.settings.rule.ranges)
        self.refused: Counter[SampleFault] = Counter()
        """Images that were not saved because something is wrong."""
        self.told: SampleFault | None = None
        """What is wrong now."""
        self.now: PairCandidate | None = None
        """The newest moment that was decided."""
        self.words = ""
        """What a refused sample says of itself."""
        self.track = WrenchHistory()
        self.trust = SampleFaultTracker(int(self.settings.trust.frozen_ms * 1e6))
        self.clocks = ClockDriftMonitor(self.settings.tolerance_ms), ClockDriftMonitor(self.settings.tolerance_ms)
        self.pending: deque[tuple[Frame, str]] = deque()
        """Images that wait for what comes after them, and the object in the hand."""
        self.taring: TareInProgress | None = TareInProgress(0, self.settings)
        self.untouched: TareReference | None = None
        self.object = ""
        self.newest_ns = 0
        self._object_decided = ""

    def hear(self, heard: Arrival[Frame | Wrench | WrenchSampleRejected]) -> None:
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
        self.taring = TareInProgress(self.untouched.number + 1 if self.untouched else 0, self.settings, self.untouched)

    def next_object(self, name: str | None = None, at_ns: int | None = None) -> None:
        """Another object from now on: the named one, else the next in turn. at_ns: when, if not now."""
        self.object = name or next(self.objects)
        self.episode.event(RecordingEvent(at_ns or self.newest_ns, EventKind.OBJECT, self.object))

    def undo(self) -> str:
        """Take back the newest contact that has pairs; what was done, in words."""
        contact = self.counters.last_contact
        if contact is None:
            return "nothing to undo"
        pairs = self.counters.undo(contact)
        self.worth.begin_contact()
        self.episode.event(RecordingEvent(self.newest_ns, EventKind.CONTACT_UNDONE, contact))
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
        self.episode.event(RecordingEvent(self.newest_ns, EventKind.TARED, str(found.number), zero))
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
        if wrench is not None and fault in (None, SampleFault.SHIFTED):
            change = self.untouched.seen.change(frame.image)
            self.now = PairCandidate(frame, self.untouched.taken_off(wrench), change)
            fault = self._fault_of(self.now, fault)
            if fault is None:
                self._save(self.now)
        self._tell(fault)

    def _fault_at(self, at_ns: int) -> SampleFault | None:
        if not all(clock.keeps for clock in self.clocks):
            return SampleFault.CLOCK
        tolerance_ns = int(self.settings.tolerance_ms * 1e6)
        if fault := self.trust.fault(at_ns - tolerance_ns, at_ns + tolerance_ns):
            return fault
        return SampleFault.UNPAIRED if self.track.distance_ns(at_ns) > tolerance_ns else None

    def _fault_of(self, moment: PairCandidate, fault: SampleFault | None) -> SampleFault | None:
        if self.rest.sees(moment):
            self.trust.at_rest()
            return None
        return SampleFault.NOT_AT_REST if self.rest.has_drifted else fault

    def _save(self, moment: PairCandidate) -> None:
        kind = self.worth.of(moment, self.counters)
        if kind is None:
            return
        frame, name = moment.frame, NO_OBJECT if kind == "no_contact" else self._object_decided
        contact = f"{self.episode.session.id}-{self.worth.contact:05d}"
        assert self.untouched is not None
        numbers = {"image": frame.index, "untouched": self.untouched.number}
        self.episode.kept_image(frame)
        self.episode.pair(
            PairLabel(frame.stamp_ns, **numbers, object=name, contact=contact, kind=kind, wrench=moment.wrench)
        )
        self.counters.add(CountedPair(kind, name, contact, moment.wrench.six))

    def _tell(self, fault: SampleFault | None) -> None:
        if fault is not None:
            self.refused[fault] += 1
            if fault is not self.told:
                self.episode.event(
                    RecordingEvent(self.newest_ns, EventKind.REMARK, fault.name.lower(), self.sentence(fault))
                )
        self.told = fault

    def sentence(self, fault: SampleFault) -> str:
        """What to tell a person of it."""
        if fault in FAULTS.values():
            return self.words or fault.value
        if fault is SampleFault.UNPAIRED:
            return f"{fault.value} (tolerance {self.settings.tolerance_ms:g} ms)"
        return fault.value
