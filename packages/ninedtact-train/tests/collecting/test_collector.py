"""What is saved is true, whatever goes wrong; what goes wrong is told."""

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hand import BEGAN_NS, BIAS, NOISE, REST_TOUCHES, TOUCH_S, TOUCHES, UNTOUCHED_S, Camera, ForceTorque, at_s, truth
from twin_folder import twin_folder

from ninedtact.calibration.sensor_folder import load_sensor
from ninedtact.capture.force_torque.sample_checks import CheckedWrenchSource, SampleCheckSettings
from ninedtact.capture.wrench_source import WrenchSaturated
from ninedtact.design import ForceTorqueMount
from ninedtact.errors import InputError
from ninedtact.quantities import NO_OBJECT, Frame, Wrench
from ninedtact.recording.background_reader import Arrival
from ninedtact.recording.metadata import RecordingMetadata
from ninedtact.recording.reader import Recording
from ninedtact.recording.recorded_source import RecordedFrameSource, RecordedWrenchSource
from ninedtact.recording.topics_and_messages import RecordingEventKind, Topic
from ninedtact.recording.writer import RecordingWriter
from ninedtact.simulation.simulated_sources import SimulatedCamera
from ninedtact_train.cli.collect import (
    CollectTerminalDisplay,
    collect_progress_line,
    handle_collect_keys,
    histogram_lines,
)
from ninedtact_train.collecting.collected_pairs import RecordedPair, read_recorded_pairs
from ninedtact_train.collecting.collection_sources import (
    MergedArrival,
    build_simulated_collect_setup,
    collection_setup_from_recordings,
    merge_recorded_streams,
)
from ninedtact_train.collecting.collector import COLLECTED_TOPICS, Collector
from ninedtact_train.collecting.pair_selection import CollectSettings
from ninedtact_train.collecting.sample_faults import SampleFault
from ninedtact_train.collecting.training_pair_rule import SamplingRuleSettings

SETTINGS = CollectSettings(checks=SampleCheckSettings(range_n=(50, 50, 50)))
REST_S = UNTOUCHED_S + TOUCHES * TOUCH_S
WHOLE_S = REST_S + REST_TOUCHES * TOUCH_S + TOUCH_S
Seen = Callable[[Frame, Collector], None]


def collected(
    path: Path,
    force_torque: ForceTorque = ForceTorque(),
    seconds: float = WHOLE_S,
    settings: CollectSettings = SETTINGS,
    camera_delay_ms: float = 0.0,
    seen: Seen = lambda frame, collector: None,
) -> tuple[Collector, list[RecordedPair]]:
    """Collect from the hand; `seen` is called after every image."""
    feed: Iterator[MergedArrival] = merge_recorded_streams(
        Camera(seconds), CheckedWrenchSource(replace(force_torque), settings.checks)
    )
    with RecordingWriter(path, RecordingMetadata("hand"), COLLECTED_TOPICS) as episode, closing(feed):
        collector = Collector(episode, settings, iter(["cup", "key", "nut"]), np.random.default_rng(0), camera_delay_ms)
        for fed in feed:
            assert fed is not None
            collector.add(fed)
            if isinstance(fed.item, Frame):
                seen(fed.item, collector)
        collector.finish()
    return collector, list(read_recorded_pairs(path))


def require_true(pairs: list[RecordedPair]) -> None:
    """Every saved wrench is what pressed when the image was taken, to what noise and tare leave."""
    for pair in pairs:
        assert (np.abs(pair.wrench.six - truth(at_s(pair.time_ns))) < 6 * NOISE + 1e-3).all(), pair.kind
        darkest = float(pair.image[18:30, 26:38].mean())
        assert darkest == pytest.approx(120 + 8 * truth(at_s(pair.time_ns))[2], abs=1)


def test_pairs_are_true_apart_and_of_all_kinds(tmp_path: Path) -> None:
    collector, pairs = collected(tmp_path / "e.mcap")
    require_true(pairs)
    kinds = [pair.kind for pair in pairs]
    assert kinds.count("rule") >= 12 and 1 <= kinds.count("light_touch") <= 2 and kinds.count("no_contact") == 1
    assert all(pair.object == (NO_OBJECT if pair.kind == "no_contact" else "cup") for pair in pairs)
    touches: dict[str, list[RecordedPair]] = {}
    for pair in pairs:
        touches.setdefault(pair.contact, []).append(pair)
    assert len(touches) == 1 + TOUCHES + 1 and collector.rejected.total() == 0
    for touch in touches.values():
        by_rule = np.array([pair.wrench.six for pair in touch if pair.kind == "rule"]).reshape(-1, 6)
        parts = (
            np.abs(by_rule[:, None] - by_rule)
            / SamplingRuleSettings().ranges
            @ np.array(SamplingRuleSettings().weights)
        )
        assert parts[~np.eye(len(parts), dtype=bool)].min(initial=1) > SamplingRuleSettings().min_difference
    assert {pair.reference.id for pair in pairs} == {f"{collector.writer.metadata.id}-u000"}
    assert len(pairs[0].reference.images) == 10 and not pairs[0].reference.images[0].flags.writeable
    assert collector.reference is not None and collector.reference.zero == pytest.approx(BIAS, abs=6e-3)
    assert sum(map(sum, collector.counts.counts)) == 6 * len(pairs)
    assert [len(line) for line in histogram_lines(collector)] and "pairs (" in collect_progress_line(collector)


def test_the_wrench_of_a_pair_is_that_of_the_exposure(tmp_path: Path) -> None:
    """A camera that stamps its images late by 60 ms; the load changes by up to 1 N in that time."""
    collector, pairs = collected(tmp_path / "late.mcap", camera_delay_ms=60.0)
    changed = 0
    for pair in pairs:
        exposed_s = at_s(pair.time_ns) - 0.06
        assert (np.abs(pair.wrench.six - truth(exposed_s)) < 6 * NOISE + 1e-3).all(), pair.kind
        changed += bool(abs(truth(exposed_s + 0.12)[2] - truth(exposed_s)[2]) > 0.5)
    assert changed > 5 and collector.counts.pairs
    assert "(tolerance 10 ms)" in collector.fault_text(SampleFault.UNPAIRED)
    assert all(
        "tolerance" not in collector.fault_text(fault) for fault in SampleFault if fault is not SampleFault.UNPAIRED
    )


def test_images_are_merged_up_to_the_last_sample_of_a_recording(tmp_path: Path) -> None:
    path, stamps_ns = tmp_path / "both.mcap", [10**12 + number * 33_000_000 for number in range(90)]
    with RecordingWriter(path, RecordingMetadata("hand")) as writer:
        for number, stamp_ns in enumerate(stamps_ns):
            writer.write_image(Frame(np.zeros((48, 64, 3), np.uint8), stamp_ns, number))
        for stamp_ns in range(10**12, stamps_ns[87] + 1, 1_000_000):  # and two images follow
            writer.write_measured(Wrench(np.ones(3), np.ones(3), stamp_ns=stamp_ns))
    items = [one.item for one in merge_recorded_streams(RecordedFrameSource(path), RecordedWrenchSource(path)) if one]
    assert [item.stamp_ns for item in items if isinstance(item, Frame)] == stamps_ns[:88]


def test_recorded_samples_are_checked_in_the_frame_of_the_device(tmp_path: Path) -> None:
    path, mount = tmp_path / "both.mcap", ForceTorqueMount(origin_mm=(1, -2, -35), rotation_deg=(180, 0, 90), sign=-1)
    with RecordingWriter(path, RecordingMetadata("hand")) as writer:
        writer.write_image(Frame(np.zeros((48, 64, 3), np.uint8), 10**12, 0))
        for number, pushed_n in enumerate((8.0, 9.0)):  # by the lever of 35 mm, the device feels 0.28 and 0.315 N·m
            wrench = Wrench(np.array([pushed_n, 0, -1.0]), np.array([0.01, 0.0, 0.0]), stamp_ns=10**12 + number * 10**6)
            writer.write_measured(wrench)
    checks = SampleCheckSettings(range_nm=(0.3, 0.3, 0.3))
    with collection_setup_from_recordings(path, path, checks, mount).force_torque as samples:
        assert samples.read().about(np.zeros(3)).six == pytest.approx([8, 0, -1, 0.01, 0, 0], abs=1e-12)
        with pytest.raises(WrenchSaturated, match=r"T_x of .* within ± 0\.294 N·m, got -?0\.31"):
            samples.read()


def test_images_and_wrenches_of_two_runs_of_a_computer_are_no_pairs(tmp_path: Path) -> None:
    for name, ahead_s in (("images", 0), ("together", 30), ("yesterday", -86_400)):
        metadata = RecordingMetadata("hand", wall_minus_monotonic_ns=10**18 + ahead_s * 10**9)
        with RecordingWriter(tmp_path / f"{name}.mcap", metadata) as writer:
            writer.write_image(Frame(np.zeros((48, 64, 3), np.uint8), 10**12, 0))
            writer.write_measured(Wrench(np.ones(3), np.ones(3), stamp_ns=10**12))
    images, together, yesterday = (tmp_path / f"{name}.mcap" for name in ("images", "together", "yesterday"))
    assert collection_setup_from_recordings(images, together, SampleCheckSettings()).wall_minus_monotonic_ns == 10**18
    with pytest.raises(InputError, match=r"expected recordings .* got .* whose clocks are 86400 s apart; name two"):
        collection_setup_from_recordings(images, yesterday, SampleCheckSettings())


def test_every_pair_is_on_disk_when_it_is_counted(tmp_path: Path) -> None:
    on_disk: list[tuple[int, int]] = []

    def look(frame: Frame, collector: Collector) -> None:
        if frame.index % 20 == 0:
            with Recording(tmp_path / "e.mcap") as episode:
                on_disk.append((len(list(episode.labels())), len(collector.counts.pairs)))

    collected(tmp_path / "e.mcap", seen=look)
    assert all(found == counted for found, counted in on_disk) and on_disk[-1][0] > 8


def test_an_object_that_is_named_before_the_first_image_begins_with_it(tmp_path: Path) -> None:
    path, camera = tmp_path / "e.mcap", Camera(1.0)
    with RecordingWriter(path, RecordingMetadata("hand"), COLLECTED_TOPICS) as episode:
        collector = Collector(episode, SETTINGS, iter(["cup", "key", "nut"]))
        collector.begin_object()
        collector.begin_object()
        for frame in (camera.read(), camera.read()):
            collector.add(Arrival(frame, frame.stamp_ns))
    with Recording(path) as read:
        assert [(event.stamp_ns, event.subject) for event in read.events()] == [(BEGAN_NS, "key")]
        assert read.began_ns == BEGAN_NS


def between(begin_s: float, end_s: float, then: Callable[[float, np.ndarray], np.ndarray | None]) -> ForceTorque:
    return ForceTorque(lambda now_s, six: then(now_s, six) if begin_s < now_s < end_s else six)


WARMED = np.array([0.4, 0, 0.9, 0, 0, 0])
SECOND_S = UNTOUCHED_S + TOUCH_S
FAULTS = {
    "freezes": (
        between(SECOND_S + 0.9, SECOND_S + 1.6, lambda now_s, six: np.array([0.1, 0.2, -5.0, 0.0, 0.0, 0.0]) + BIAS),
        SampleFault.FROZEN,
    ),
    "spikes": (between(SECOND_S + 1.0, SECOND_S + 1.01, lambda now_s, six: six + 20.0), SampleFault.JUMPED),
    "shifts": (
        between(SECOND_S + 1.0, 99, lambda now_s, six: six + np.array([0, 12.0, 0, 0, 0, 0])),
        SampleFault.SHIFTED,
    ),
    "shifts while nothing touches": (
        between(SECOND_S + 0.2, 99, lambda now_s, six: six + np.array([0, 12.0, 0, 0, 0, 0])),
        SampleFault.SHIFTED,
    ),
    "is away and comes back with another zero": (
        between(SECOND_S - 0.5, 99, lambda now_s, six: None if now_s < SECOND_S + 0.7 else six + WARMED),
        SampleFault.SHIFTED,
    ),
    "drifts": (
        between(REST_S, 99, lambda now_s, six: six + 0.05 * (now_s > REST_S) * np.eye(6)[4]),
        SampleFault.NOT_AT_REST,
    ),
    "saturates": (
        between(SECOND_S, 99, lambda now_s, six: np.array([*six[:2], max(six[2], -4.41), *six[3:]])),
        SampleFault.SATURATED,
    ),
    "is silent": (between(SECOND_S + 0.9, SECOND_S + 1.6, lambda now_s, six: None), SampleFault.UNPAIRED),
}


@pytest.mark.parametrize("what", FAULTS)
def test_a_sensor_that_errs_is_told_and_nothing_untrue_is_saved(what: str, tmp_path: Path) -> None:
    force_torque, fault = FAULTS[what]
    trust = SampleCheckSettings(range_n=(50, 50, 4.5 if what == "saturates" else 50))
    settings = replace(SETTINGS, checks=trust, tolerance_ms=10.0)
    collector, pairs = collected(tmp_path / "e.mcap", force_torque, settings=settings)
    require_true([pair for pair in pairs if what != "drifts" or at_s(pair.time_ns) < REST_S])
    assert collector.rejected[fault] > 0
    with Recording(tmp_path / "e.mcap") as episode:
        told = [event for event in episode.events() if event.kind is RecordingEventKind.REMARK]
        sampled_ns = np.array([wrench.stamp_ns for wrench in episode.wrenches(Topic.MEASURED)])
    assert all(np.abs(sampled_ns - pair.time_ns).min() <= 10e6 for pair in pairs)
    stamps_ns = [event.stamp_ns for event in told if event.subject == fault.name.lower() and event.text]
    if what in ("shifts", "shifts while nothing touches", "is away and comes back with another zero", "drifts"):
        assert not [pair for pair in pairs if pair.time_ns > stamps_ns[0]]
    elif what != "saturates":
        assert [pair for pair in pairs if pair.time_ns > stamps_ns[0] + 1e9]


def test_contacts_are_undone_one_by_one_and_objects_follow_each_other(tmp_path: Path) -> None:
    screen, words = CollectTerminalDisplay(), []

    def keys(frame: Frame, collector: Collector) -> None:
        typed = {
            round(30 * (UNTOUCHED_S + touches * TOUCH_S) + 8): keys
            for touches, keys in ((1, "n"), (2, "uuun"), (3, "u"))
        }
        if frame.index in typed:
            before = len(collector.counts.pairs)
            assert handle_collect_keys(typed[frame.index], collector, screen)
            words.append((before, len(collector.counts.pairs)))

    collector, pairs = collected(tmp_path / "e.mcap", seen=keys)
    (one, same), (_, none_left), (three, undone) = words
    assert one == same > 1 and none_left == 1 and three > undone == 1  # the pair without contact stays
    assert not handle_collect_keys("xq", collector, screen)
    assert {pair.object for pair in pairs} == {NO_OBJECT, "nut"} and len(pairs) == len(collector.counts.pairs)
    assert min(pair.time_ns for pair in pairs if pair.object == "nut") / 1e9 > 7 + REST_S + REST_TOUCHES * TOUCH_S
    assert collector.counts.counts.sum() == 6 * len(pairs) and collector.counts.counts.min() == 0
    with Recording(tmp_path / "e.mcap") as episode:
        assert len(list(episode.labels())) > len(pairs) + 10


def test_an_undone_contact_does_not_return_with_the_images_that_wait(tmp_path: Path) -> None:
    path, undone_at = tmp_path / "e.mcap", round(30 * (SECOND_S + 1.5))
    with Camera(5.0) as camera, ForceTorque() as force_torque:  # in the order in which devices deliver
        items = [*camera, *(force_torque.read() for _ in range(round(5.0 * force_torque.hz)))]
    with RecordingWriter(path, RecordingMetadata("hand"), COLLECTED_TOPICS) as episode:
        collector = Collector(episode, SETTINGS, iter(["cup"]), np.random.default_rng(0))
        for item in sorted(items, key=lambda item: item.stamp_ns):
            collector.add(Arrival(item, item.stamp_ns))
            if isinstance(item, Frame) and item.index == undone_at:
                assert collector.undo_last_contact().startswith("undone: the last contact")
        collector.finish()
    times_s = np.array([at_s(pair.time_ns) for pair in read_recorded_pairs(path)])
    assert not ((times_s > SECOND_S + 0.3) & (times_s < undone_at / 30)).any() and (times_s < SECOND_S).sum() > 3


def test_a_tare_waits_for_untouched_skin_and_begins_a_new_reference(tmp_path: Path) -> None:
    advice: list[str] = []

    def tare(frame: Frame, collector: Collector) -> None:
        if frame.index == round(30 * (SECOND_S + 0.8)):  # in the middle of a touch
            collector.begin_tare()
        if collector.tare_in_progress is not None and frame.index > 30 * SECOND_S:
            advice.append(collector.tare_in_progress.advice)

    warmed = between(SECOND_S + 0.85, 99, lambda now_s, six: six + WARMED)
    collector, pairs = collected(tmp_path / "e.mcap", warmed, seen=tare)
    require_true(pairs)
    assert [pair.reference.id[-1] for pair in pairs] == sorted(pair.reference.id[-1] for pair in pairs)
    after = [pair for pair in pairs if pair.reference.id.endswith("u001")]
    assert min(at_s(pair.time_ns) for pair in after) > REST_S and {pair.kind for pair in after} >= {"rule"}
    assert any("at rest" in words or "untouched:" in words for words in advice)
    assert collector.reference is not None and collector.reference.zero[:3] == pytest.approx(
        (BIAS + WARMED)[:3], abs=0.02
    )


def test_a_simulated_collection_names_the_object_that_presses(tmp_path: Path) -> None:
    setup = build_simulated_collect_setup(
        load_sensor(twin_folder(tmp_path / "sensor")), ("ball:4", "cylinder:3,11"), 1, 0, SampleCheckSettings()
    )
    assert isinstance(setup.camera, SimulatedCamera) and setup.object_at is not None
    simulation = setup.camera.simulation
    simulation.clock.start_ns = 5_000_000_000
    first_s, second_s = simulation.ends_s
    assert second_s > first_s > 1.5  # the first begins with skin that nothing touches
    for moment_s, name in ((0, "ball:4"), (first_s - 0.01, "ball:4"), (first_s + 0.01, "cylinder:3,11")):
        frame = Frame(np.zeros((4, 4, 3), np.uint8), 5_000_000_000 + round(1e9 * moment_s), 0)
        assert setup.object_at(frame) == name
