"""The collector of training pairs: images and force/torque samples go in, labelled images in a recording come out.

image ──waits until later samples are known──▶ wrench at its time ──without fault?──▶ selected? ──▶ recording

Only stamps count, never the time of processing: live devices, simulated sensors and recordings are collected by the same steps.
"""

import json
from bisect import bisect_left
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, field
from itertools import chain, count
from pathlib import Path

import numpy as np

from ninedtact.calibration.drift.reference_check import load_reference_image_checker
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.capture.frame_source import SourceIncomplete
from ninedtact.capture.wrench_source import WrenchSampleRejected
from ninedtact.quantities import NO_OBJECT, Frame, Wrench
from ninedtact.recording.attached_sensor import sensor_folder_attachments
from ninedtact.recording.background_reader import Arrival
from ninedtact.recording.metadata import RecordingMetadata, wall_minus_monotonic_ns
from ninedtact.recording.topics_and_messages import PairLabel, RecordingEvent, RecordingEventKind, Topic
from ninedtact.recording.writer import RecordingWriter
from ninedtact.shape.calibrated_shape import FindReferenceFaults
from ninedtact_train.collecting.collection_sources import CollectSetup, MergedArrival
from ninedtact_train.collecting.collection_tare import TareInProgress, TareResult
from ninedtact_train.collecting.pair_selection import (
    CollectSettings,
    ImageWrenchCandidate,
    PairSelector,
    SavedPairCounts,
    ZeroDriftMonitor,
)
from ninedtact_train.collecting.sample_faults import (
    REJECTION_FAULTS,
    ClockDriftMonitor,
    SampleFault,
    SampleFaultHistory,
)
from ninedtact_train.collecting.training_pair_rule import SamplingRule

COLLECTED_TOPICS = (Topic.IMAGES, Topic.REFERENCE, Topic.MEASURED, Topic.LABELS)
_HISTORY_NS = 5_000_000_000
_LONGEST_WAIT_NS = 1_000_000_000
"""Longest time for which an image waits for samples."""


class WrenchHistory:
    """The samples of the last seconds, about the skin centre, and the wrench interpolated at any time among them."""

    def __init__(self) -> None:
        self.samples: deque[Wrench] = deque()

    def add(self, wrench: Wrench) -> None:
        """Add a sample that is newer than all before."""
        self.samples.append(wrench)
        while wrench.stamp_ns - self.samples[0].stamp_ns > _HISTORY_NS:
            self.samples.popleft()

    @property
    def newest_ns(self) -> int:
        """Stamp of the newest sample, 0 before the first."""
        return self.samples[-1].stamp_ns if self.samples else 0

    def interpolate(self, at_ns: int, within_ns: int) -> Wrench | None:
        """Return the wrench at this time, linear between the neighbouring samples; None where one is missing or farther away."""
        place = bisect_left(self.samples, at_ns, key=lambda wrench: wrench.stamp_ns)
        if place == len(self.samples):
            return None
        after = self.samples[place]
        before = after if after.stamp_ns == at_ns or place == 0 else self.samples[place - 1]
        if not at_ns - within_ns <= before.stamp_ns <= at_ns or after.stamp_ns > at_ns + within_ns:
            return None
        part = (at_ns - before.stamp_ns) / max(after.stamp_ns - before.stamp_ns, 1)
        force_n, torque_nm = ((1 - part) * before.six + part * after.six).reshape(2, 3)
        return Wrench(force_n, torque_nm, stamp_ns=at_ns)


def _numbered_objects() -> Iterator[str]:
    return (f"object_{number:03d}" for number in count(1))


@dataclass
class Collector:
    """Saves pairs into an open recording, beginning with a tare. `collect_pairs` adds what a sensor's devices deliver."""

    writer: RecordingWriter
    settings: CollectSettings = CollectSettings()
    objects: Iterator[str] = field(default_factory=_numbered_objects)
    """Names of the objects, in turn."""
    rng: np.random.Generator = field(default_factory=np.random.default_rng)
    camera_delay_ms: float = 0.0
    """How long before its stamp an image shows the skin: half the exposure, and the transfer to the computer. It is negative for a
    camera that stamps the beginning of a long exposure."""
    find_reference_faults: FindReferenceFaults = lambda _: ()
    notify: Callable[[str], None] = lambda _: None
    """Receives a sentence for the person who collects."""

    def __post_init__(self) -> None:
        self.selector = PairSelector(self.settings, SamplingRule(self.settings.rule, self.rng))
        self.zero_drift = ZeroDriftMonitor(self.settings)
        self.counts = SavedPairCounts(self.settings.rule.ranges)
        self.rejected: Counter[SampleFault] = Counter()
        """Images that were not saved because of a fault."""
        self.fault: SampleFault | None = None
        """The present fault."""
        self.newest: ImageWrenchCandidate | None = None
        """The newest moment that was decided."""
        self.sample_faults = SampleFaultHistory(int(self.settings.checks.frozen_ms * 1e6))
        self.clocks = ClockDriftMonitor(self.settings.tolerance_ms), ClockDriftMonitor(self.settings.tolerance_ms)
        self.tare_in_progress: TareInProgress | None = TareInProgress(0, self.settings)
        self.reference: TareResult | None = None
        self.object = ""
        self._object_waits = False
        """Whether the object was named before the first image, and is recorded with it."""
        self._rejection_text = ""
        self._history = WrenchHistory()
        self._pending: deque[tuple[Frame, str]] = deque()
        """Images that wait for later samples, and the object at their time."""
        self._newest_ns = 0
        self._decided_object = ""

    def add(self, arrival: Arrival[Frame | Wrench | WrenchSampleRejected]) -> None:
        """Add an image, a sample, or a rejected sample; images and samples each in the order of their stamps."""
        if isinstance(arrival.item, Frame):
            self.clocks[0].add_arrival(arrival.item.stamp_ns, arrival.at_ns)
            self._add_frame(arrival.item)
        elif isinstance(arrival.item, Wrench):
            self.clocks[1].add_arrival(arrival.item.stamp_ns, arrival.at_ns)
            self._add_wrench(arrival.item)
        else:
            self.sample_faults.reject(arrival.item)
            self._rejection_text = str(arrival.item)

    def _add_frame(self, frame: Frame) -> None:
        self._newest_ns = max(self._newest_ns, frame.stamp_ns)
        if self._object_waits:
            self.begin_object(self.object)
        if self.tare_in_progress is not None:
            self.tare_in_progress.add_frame(frame)
            self._finish_tare()
        else:
            self._pending.append((frame, self.object))
            self._decide_pending()

    def _add_wrench(self, sample: Wrench) -> None:
        wrench = sample.about_skin_centre()
        self.writer.write_measured(wrench)
        if not self.sample_faults.accept(wrench):
            return
        self._history.add(wrench)
        if self.tare_in_progress is not None:
            self.tare_in_progress.add_wrench(wrench)
        else:
            self._decide_pending()

    def begin_tare(self) -> None:
        """Take new reference images and a new zero from the frames and samples that follow."""
        self._pending.clear()
        number = self.reference.number + 1 if self.reference else 0
        self.tare_in_progress = TareInProgress(number, self.settings, self.reference)

    def begin_object(self, name: str | None = None, at_ns: int | None = None) -> None:
        """Continue with another object: the named one, else the next in turn. at_ns: since when, if not now.

        Before the first image there is no time yet: the object is then recorded with that image.
        """
        self.object = name or next(self.objects)
        stamp_ns = at_ns or self._newest_ns
        self._object_waits = stamp_ns == 0
        if not self._object_waits:
            self.writer.write_event(RecordingEvent(stamp_ns, RecordingEventKind.OBJECT, self.object))

    def undo_last_contact(self) -> str:
        """Remove the newest contact that has pairs, and the images that still wait; return what was done as text."""
        self._pending.clear()
        contact = self.counts.last_contact
        if contact is None:
            return "nothing to undo"
        pairs = self.counts.undo(contact)
        self.selector.begin_contact()
        self.writer.write_event(RecordingEvent(self._newest_ns, RecordingEventKind.CONTACT_UNDONE, contact))
        return f"undone: the last contact with its {pairs} pairs"

    def finish(self) -> None:
        """Decide on the images that still wait, because no more samples will arrive."""
        while self._pending:
            self._decide(*self._pending.popleft())

    @property
    def tare_advice(self) -> str:
        """What a person should do during a tare, or why no samples come; empty where none is taken."""
        if self.tare_in_progress is None:
            return ""
        return self.tare_in_progress.advice if self.sample_faults.rejection is None else self._rejection_text

    def fault_text(self, fault: SampleFault) -> str:
        """Return a fault as a sentence for a person."""
        if fault in REJECTION_FAULTS.values():
            return self._rejection_text or fault.value
        if fault is SampleFault.UNPAIRED:
            return f"{fault.value} (tolerance {self.settings.tolerance_ms:g} ms)"
        return fault.value

    def _finish_tare(self) -> None:
        assert self.tare_in_progress is not None
        reference = self.tare_in_progress.finish()
        if reference is None:
            return
        self.reference, self.tare_in_progress = reference, None
        for frame in reference.frames:
            self.writer.write_reference(frame, reference.number)
        for fault in self.find_reference_faults(reference.frames):
            self.writer.write_event(
                RecordingEvent(self._newest_ns, RecordingEventKind.REMARK, "reference image", fault)
            )
            self.notify(f"the reference image is doubtful; {fault}")
        zero = " ".join(f"{number:.6g}" for number in reference.zero)
        self.writer.write_event(RecordingEvent(self._newest_ns, RecordingEventKind.TARED, str(reference.number), zero))
        self.sample_faults.confirm_zero(self._history.newest_ns)
        self.zero_drift.reset()
        if not self.object:
            self.begin_object()

    def _decide_pending(self) -> None:
        while self._pending:
            at_ns = self._exposed_ns(self._pending[0][0])
            is_early = self._history.newest_ns < at_ns + self.settings.decision_delay_ns
            if is_early and self._newest_ns < at_ns + _LONGEST_WAIT_NS:
                return
            self._decide(*self._pending.popleft())

    def _exposed_ns(self, frame: Frame) -> int:
        return frame.stamp_ns - int(self.camera_delay_ms * 1e6)

    def _decide(self, frame: Frame, name: str) -> None:
        assert self.reference is not None
        if name != self._decided_object:
            self._decided_object = name
            self.selector.begin_contact()
        at_ns, tolerance_ns = self._exposed_ns(frame), int(self.settings.tolerance_ms * 1e6)
        wrench = self._history.interpolate(at_ns, tolerance_ns)
        fault = self.sample_faults.fault_between(at_ns - tolerance_ns, at_ns + tolerance_ns)
        if not all(clock.is_within_tolerance for clock in self.clocks):
            fault = SampleFault.CLOCK
        elif fault is None and wrench is None:
            fault = SampleFault.UNPAIRED
        if wrench is not None and fault in (None, SampleFault.SHIFTED):
            change_levels = self.reference.detector.change_levels(frame.image)
            self.newest = ImageWrenchCandidate(frame, self.reference.remove_zero(wrench), change_levels)
            fault = self._fault_of_zero(self.newest, fault)
            if fault is None:
                self._save(self.newest)
        self._report(fault)

    def _fault_of_zero(self, candidate: ImageWrenchCandidate, fault: SampleFault | None) -> SampleFault | None:
        if self.zero_drift.check(candidate):
            self.sample_faults.confirm_zero(self._exposed_ns(candidate.frame))
            return None
        return SampleFault.NOT_AT_REST if self.zero_drift.has_drifted else fault

    def _save(self, candidate: ImageWrenchCandidate) -> None:
        kind = self.selector.select(candidate, self.counts)
        if kind is None:
            return
        frame, name = candidate.frame, NO_OBJECT if kind == "no_contact" else self._decided_object
        contact = f"{self.writer.metadata.id}-{self.selector.contact:05d}"
        assert self.reference is not None
        self.writer.write_selected_image(frame)
        label = PairLabel(
            frame.stamp_ns, frame.index, self.reference.number, name, contact, kind, wrench=candidate.wrench
        )
        self.writer.write_label(label)
        self.counts.add(label)

    def _report(self, fault: SampleFault | None) -> None:
        if fault is not None:
            self.rejected[fault] += 1
            if fault is not self.fault:
                name, text = fault.name.lower(), self.fault_text(fault)
                self.writer.write_event(RecordingEvent(self._newest_ns, RecordingEventKind.REMARK, name, text))
        self.fault = fault


def collect_pairs(
    setup: CollectSetup,
    out: Path | str,
    sensor: SensorFolder,
    settings: CollectSettings = CollectSettings(),
    objects: Sequence[str] = (),
    seed: int | None = None,
    camera_delay_ms: float = 0.0,
    should_stop: Callable[[Collector], bool] = lambda collector: False,
    notify: Callable[[str], None] = lambda sentence: None,
    on_progress: Callable[[Collector], None] = lambda collector: None,
) -> Collector:
    """Collect training pairs into a new MCAP file until `should_stop` is true or the sources end; return the collector.

    sensor: its folder is attached to the file. objects: their names in turn; after the last, object_001, object_002 and so on.
    seed: of the load below which the first pair of each contact is saved; None for a random one. camera_delay_ms: how long before
    its stamp an image shows the skin. should_stop: called before every image and sample, and while none arrives; it may also begin
    the next object, undo a contact or take a tare. notify: receives a sentence for the person who collects. on_progress: called
    after every image and sample.

    Raises `OutputError`, `RecordingStopped` and what a lost device raises; every pair that was saved before is kept.
    """
    ahead_ns = setup.wall_minus_monotonic_ns
    metadata = RecordingMetadata(
        sensor=sensor.id,
        purpose="collect",
        source=setup.camera.name,
        force_torque=setup.force_torque.name,
        settings=json.dumps({**asdict(settings), "camera_delay_ms": camera_delay_ms}),
        camera_delay_ms=setup.camera_delay_ms,
        wall_minus_monotonic_ns=wall_minus_monotonic_ns() if ahead_ns is None else ahead_ns,
    )
    writer = RecordingWriter(out, metadata, COLLECTED_TOPICS, sensor_folder_attachments(sensor.path), notify)
    collector = Collector(
        writer,
        settings,
        chain(objects, _numbered_objects()),
        np.random.default_rng(seed),
        camera_delay_ms,
        load_reference_image_checker(sensor).find_faults,
        notify,
    )
    with writer, closing(setup.arrivals()) as arrivals:
        try:
            for arrival in arrivals:
                if should_stop(collector):
                    break
                _add_arrival(collector, arrival, setup)
                on_progress(collector)
        except SourceIncomplete:
            collector.finish()
            raise
        collector.finish()
    return collector


def _add_arrival(collector: Collector, arrival: MergedArrival, setup: CollectSetup) -> None:
    """Add what arrived, and take notice of a new object and of a force/torque sensor that is back."""
    if setup.was_away.is_set():
        setup.was_away.clear()
        collector.sample_faults.mark_zero_uncertain()
    if arrival is None:
        return
    if isinstance(arrival.item, Frame) and setup.object_at is not None:
        name = setup.object_at(arrival.item)
        if name != collector.object:
            collector.begin_object(name, arrival.item.stamp_ns)
    collector.add(arrival)
