"""The sensor in a MuJoCo scene: MuJoCo's own rays see the same undersides, and its forces are those of the gel."""

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

mujoco = pytest.importorskip("mujoco", reason="the extra 'mujoco' is not installed")

from ninedtact import default_twin  # noqa: E402
from ninedtact.calibration.sensor_folder import SensorFolder  # noqa: E402
from ninedtact.errors import InputError  # noqa: E402
from ninedtact.interop.mujoco import (  # noqa: E402
    TactileReading,
    TactileSensor,
)
from ninedtact.mechanics.indenter import FlatPunch  # noqa: E402
from ninedtact.mechanics.pose import Pose  # noqa: E402
from ninedtact_train.environments.mujoco_batch import TactileSensorBatch  # noqa: E402

TWIN = default_twin()


@pytest.fixture(autouse=True)
def stable_scenes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """MuJoCo warns of scenes that become unstable, in a file MUJOCO_LOG.TXT where it runs."""
    monkeypatch.chdir(tmp_path)
    yield
    log = tmp_path / "MUJOCO_LOG.TXT"
    assert not log.exists(), log.read_text()


GEL = '<geom name="gel" type="box" pos="0 0 -0.0025" size="0.01475 0.01125 0.0025" friction="1" solref="0.01 1"/>'
GEOMS = {
    "sphere": 'type="sphere" size="0.004"',
    "ellipsoid": 'type="ellipsoid" size="0.005 0.003 0.004" euler="20 30 10"',
    "box": 'type="box" size="0.004 0.003 0.005" euler="10 25 40"',
    "cylinder": 'type="cylinder" size="0.003 0.004" euler="70 10 0"',
    "capsule": 'type="capsule" size="0.003 0.004" euler="80 0 30"',
    "mesh": 'type="mesh" mesh="wedge" euler="10 20 30"',
}
WEDGE = '<asset><mesh name="wedge" vertex="-.004 -.003 0  .004 -.003 0  0 .004 0  0 0 -.004  0.001 0 .003"/></asset>'


def scene(
    geom: str, joints: str = '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>'
) -> tuple[Any, Any]:
    """An object over a sensor that is turned in the world, so that a frame that is forgotten shows."""
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep="0.002" gravity="0 0 0" cone="elliptic" impratio="10"/>{WEDGE}
        <worldbody><body name="stage" pos="0.1 0.2 0.3" euler="30 100 20">
        <body name="sensor">{GEL}</body><body name="empty"/>
        <body name="object" pos="0.001 -0.001 0.0039">{joints}<geom {geom} mass="0.02"/></body>
        </body></worldbody></mujoco>"""
    )
    return model, mujoco.MjData(model)


def pressed(
    model: Any, data: Any, sensor: TactileSensor, push_n: float, drag_n: float, steps: int = 30
) -> TactileReading:
    """The reading after forces along the joints have grown to these."""
    for step in range(steps):
        data.qfrc_applied[:2] = min(1, max(0, (step - 8) / 12)) * drag_n, -push_n
        data.qfrc_applied[:2] -= 0.2 * data.qvel[:2]
        mujoco.mj_step(model, data, 8)
        reading = sensor.step()
    return reading


@pytest.mark.parametrize("kind", GEOMS)
def test_a_solid_has_the_underside_that_rays_of_mujoco_hit(kind: str) -> None:
    model, data = scene(GEOMS[kind])
    mujoco.mj_forward(model, data)
    sensor = TactileSensor(model, data, "sensor", TWIN)
    solid = sensor._scene.solid(1, np.zeros(3))
    frame, origin = data.body("sensor").xmat.reshape(3, 3), data.body("sensor").xpos
    x, y = np.meshgrid(np.linspace(-4.9, 6.1, 23), np.linspace(-5.9, 4.1, 21))
    heights, hit = solid.lowest_mm(x, y), np.zeros(1, np.int32)
    only = np.array([1, 0, 0, 0, 0, 0], np.uint8)
    model.geom_group[:] = [1, 0]
    far = [
        mujoco.mj_ray(model, data, origin + frame @ [a / 1e3, b / 1e3, -0.05], frame[:, 2].copy(), only, 1, -1, hit)
        for a, b in zip(x.ravel(), y.ravel(), strict=True)
    ]
    seen = np.where(np.array(far) < 0, np.inf, 1e3 * np.array(far) - 50.0).reshape(x.shape)
    both = np.isfinite(heights) & np.isfinite(seen)
    assert both.sum() > 60
    assert (np.isfinite(heights) != np.isfinite(seen)).sum() <= (
        0 if kind != "mesh" else 0.25 * both.sum()
    )  # a raster rounds its rim
    close = abs(heights[both] - seen[both])
    assert close.max() < 1e-6 if kind != "mesh" else np.quantile(close, 0.8) < 0.02


@pytest.mark.parametrize("kind", ["sphere", "cylinder", "mesh"])
def test_the_gel_resists_with_the_load_and_the_friction_of_the_scene(kind: str) -> None:
    model, data = scene(GEOMS[kind])
    sensor = TactileSensor(model, data, "sensor", TWIN)
    sensor.open()
    untouched = sensor.step()
    assert not untouched.wrench.force_n.any()
    assert not untouched.heights.z_mm.any()
    reading = pressed(model, data, sensor, 1.5, 0.5)
    gel, scene_force = reading.wrench.force_n, reading.scene_wrench.force_n
    assert scene_force[2] == pytest.approx(-1.5, abs=0.05)
    assert scene_force[0] == pytest.approx(0.5, abs=0.05)
    assert gel[2] == pytest.approx(scene_force[2], rel=0.01)
    assert np.hypot(*(gel - scene_force)[:2]) < 0.06 * 1.5
    assert reading.heights.z_mm.min() < -0.15
    difference = abs(reading.frame.image.astype(int) - untouched.frame.image)
    assert difference.max() > 15
    assert reading.frame.stamp_ns == round(data.time * 1e9)


def test_a_rolling_ball_moves_over_the_skin_and_keeps_its_load() -> None:
    slides = '<joint type="slide" axis="1 0 0" damping="5"/><joint type="slide" axis="0 0 1" damping="1"/>'
    joints = slides + '<joint type="hinge" axis="0 1 0"/>'
    model, data = scene(GEOMS["sphere"], joints)
    sensor = TactileSensor(model, data, "sensor", TWIN)
    sensor.open()
    lowest = []
    for _ in range(24):
        data.qfrc_applied[:2] = 0.1, -1.0
        mujoco.mj_step(model, data, 8)
        reading = sensor.step()
        z = reading.heights.z_mm
        lowest.append((np.argmin(z) % z.shape[1] + 0.5 - z.shape[1] / 2) * 0.2)
    assert lowest[-1] - lowest[5] > 3.0
    assert lowest[-1] == pytest.approx(1.0 + 1e3 * data.qpos[0], abs=0.5)
    assert reading.wrench.force_n[2] == pytest.approx(-1.0, abs=0.05)


def test_a_body_that_turns_on_turns_the_skin_on() -> None:
    """The gel resists with the torque of the whole twist, not with that of the last step."""
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option gravity="0 0 0"/><worldbody><body name="sensor">{GEL}</body><body pos="0 0 0.004">
        <joint type="slide" axis="0 0 1" damping="5"/><joint type="hinge" axis="0 0 1"/>
        <geom type="cylinder" size="0.003 0.004" mass="0.02" condim="4"/></body></worldbody></mujoco>"""
    )
    data = mujoco.MjData(model)
    sensor = TactileSensor(model, data, "sensor", TWIN, TWIN.pitch_mm)
    data.qfrc_applied[0] = -5.0
    mujoco.mj_step(model, data, 200)
    twisted = None
    for step in range(5):
        data.qpos[1], data.qvel[:] = 0.03 * step, 0
        mujoco.mj_forward(model, data)
        reading = sensor.step()
        twin, load_n = replace(TWIN, friction=float(reading.contact.friction)), -reading.scene_wrench.force_n[2]
        twisted = twin.press(twisted, FlatPunch(3.0, 0.05), Pose(depth_mm=0.3, twist_rad=0.03 * step), load_n)
    assert twisted.wrench.torque_nm[2] > 1.5e-3
    assert reading.wrench.torque_nm[2] == pytest.approx(twisted.wrench.torque_nm[2], rel=0.05)


def test_bodies_that_cannot_be_used_are_refused_in_one_sentence() -> None:
    model, data = scene('type="plane" size="0.01 0.01 0.01" euler="180 0 0"', "")
    with pytest.raises(InputError, match="one of stage, sensor, empty, object, got 'hand'"):
        TactileSensor(model, data, "hand", TWIN)
    with pytest.raises(InputError, match="body empty to have a geom that collides"):
        TactileSensor(model, data, "empty", TWIN)
    mujoco.mj_forward(model, data)
    with pytest.raises(InputError, match="got a plane"):
        TactileSensor(model, data, "sensor", TWIN)._scene.solid(1, np.zeros(3))


def rod_on_gel_and_housing() -> tuple[Any, Any]:
    """A rod that lies half on the gel and half on the housing beside it, which are geoms of one body."""
    housing = '<geom name="housing" type="box" pos="0.03 0 -0.0025" size="0.01 0.01125 0.0025" solref="0.01 1"/>'
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><worldbody><body name="sensor">{housing}{GEL}</body><body name="rod" pos="0.0155 0 0.0029"><freejoint/>
        <geom type="capsule" size="0.003" fromto="-0.02 0 0 0.02 0 0" mass="0.2"/></body></worldbody></mujoco>"""
    )
    return model, mujoco.MjData(model)


def test_the_geom_of_the_gel_must_be_given_where_several_collide() -> None:
    model, data = rod_on_gel_and_housing()
    several = (
        r"expected one geom of body sensor that collides, got 2 \('housing', 'gel'\); pass that of the gel as geom"
    )
    with pytest.raises(InputError, match=several):
        TactileSensor(model, data, "sensor", TWIN)
    with pytest.raises(InputError, match=several):
        TactileSensorBatch([(model, data)], "sensor", TWIN)
    for wrong in ("skin", 2, -1):
        with pytest.raises(InputError, match=f"that collides, one of 'housing', 'gel', got {wrong!r}; correct it"):
            TactileSensor(model, data, "sensor", TWIN, geom=wrong)
    model.geom("housing").contype = model.geom("housing").conaffinity = 0
    assert TactileSensor(model, data, "sensor", TWIN)._scene.geom == 1


def test_scenes_in_a_batch_get_the_contacts_that_each_gets_alone() -> None:
    kinds = ["sphere", "box", "mesh"]
    alone = [TactileSensor(*scene(GEOMS[kind]), "sensor", TWIN) for kind in kinds]
    batch = TactileSensorBatch([scene(GEOMS[kind]) for kind in kinds], "sensor", TWIN)
    assert all(one.twin is batch.twin for one in batch.sensors)
    for sensor in alone:
        sensor.open()
    for step in range(12):
        for number, sensor in enumerate([*alone, *batch.sensors]):
            sensor.data.qfrc_applied[:2] = 0.02 * step, -1.0 - 0.2 * (number % 3)
            sensor.data.qfrc_applied[:2] -= 0.2 * sensor.data.qvel[:2]
            mujoco.mj_step(sensor.model, sensor.data, 8)
        one_by_one, at_once = [sensor.step() for sensor in alone], batch.step()
    for single, batched in zip(one_by_one, at_once, strict=True):
        assert single.wrench.force_n[2] < -0.9
        np.testing.assert_allclose(batched.wrench.force_n, single.wrench.force_n, atol=2e-3)
        np.testing.assert_array_equal(batched.scene_wrench.six, single.scene_wrench.six)
        assert np.quantile(abs(batched.heights.z_mm - single.heights.z_mm), 0.99) < 0.02
        assert abs(batched.frame.image.astype(int) - single.frame.image).mean() < 0.1
        assert (batched.frame.index, batched.frame.stamp_ns) == (single.frame.index, single.frame.stamp_ns)
    batch.reset([1])
    model, data = batch.scenes[1]
    mujoco.mj_resetData(model, data)
    data.qpos[1] = 0.01
    mujoco.mj_forward(model, data)
    assert not batch.step()[1].wrench.six.any()


@pytest.mark.interop
def test_a_batch_gives_the_same_with_torch() -> None:
    torch = pytest.importorskip("torch")
    readings = []
    for like in (np.zeros((), np.float32), torch.zeros((), dtype=torch.float32)):
        batch = TactileSensorBatch([scene(GEOMS[kind]) for kind in ("sphere", "cylinder")], "sensor", TWIN, like)
        for _ in range(5):
            for model, data in batch.scenes:
                data.qfrc_applied[:2] = -0.2 * data.qvel[:2] - (0.0, 1.0)
                mujoco.mj_step(model, data, 8)
            last = batch.step()
        readings.append(last)
    for one, other in zip(*readings, strict=True):
        assert one.wrench.force_n[2] == pytest.approx(-1.0, abs=0.05)
        np.testing.assert_allclose(one.wrench.force_n, other.wrench.force_n, atol=1e-3)
        assert abs(one.frame.image.astype(int) - other.frame.image).mean() < 0.2


def follow_the_rail(observation: dict[str, Any]) -> list[float]:
    _, _, load, about_x, *_ = observation["wrench"]
    return [0.5, 0.15 * 1e3 * about_x / max(-load, 0.1), 0.6 * (1 + load)]


def roll_the_ball(observation: dict[str, Any]) -> list[float]:
    _, _, load, about_x, about_y, _ = observation["wrench"]
    ball_mm = 1e3 * np.array([-about_y, about_x]) / min(load, -0.1)  # where the load acts
    return [*(observation["goal_mm"] - ball_mm), 0.0]


def insert_the_peg(observation: dict[str, Any]) -> list[float]:
    side, along, away = observation["wrench"][:3]
    beside = away + 3.0  # the thumb presses with 3 N
    return [2 * side, beside, 0.7 + 2 * along - abs(side) - abs(beside)]


def push_blindly(observation: dict[str, Any]) -> list[float]:
    return [0.0, 0.0, 1.0]


def episode(env: Any, controller: Any, seed: int = 1) -> tuple[dict[str, Any], float, dict[str, Any]]:
    """What is known at the beginning of an episode that ends by itself, its reward, and what is known at the end."""
    observation, begin = env.reset(seed=seed)
    total, ended = 0.0, False
    while not ended:
        action = np.clip(controller(observation), -1, 1).astype(np.float32)
        observation, reward, ended, truncated, state = env.step(action)
        assert not truncated
        total += reward
    return begin, total, state


@pytest.fixture
def make_env() -> Any:
    gymnasium = pytest.importorskip("gymnasium", reason="the extra 'mujoco' is not installed")
    import ninedtact_train.environments.ball_rolling_environment
    import ninedtact_train.environments.edge_following_environment
    import ninedtact_train.environments.peg_insertion_environment  # noqa: F401 - importing registers them

    return gymnasium.make


@pytest.mark.interop
@pytest.mark.filterwarnings("ignore:.*Box observation space:UserWarning")
@pytest.mark.parametrize(
    ("task", "controller"),
    [
        ("EdgeFollowing", follow_the_rail),
        ("BallRolling", roll_the_ball),
        ("PegInsertion", insert_the_peg),
    ],
    ids=["edge", "ball", "peg"],
)
def test_gymnasium_accepts_an_environment_and_a_simple_controller_does_the_task(
    task: str, controller: Any, make_env: Any
) -> None:
    from gymnasium.utils.env_checker import check_env

    env = make_env(f"ninedtact/{task}-v0", sensor_folder=TWIN, render_mode="rgb_array")
    check_env(env.unwrapped)
    begin, total, state = episode(env, controller)
    if task == "PegInsertion":
        assert state["tip_mm"][2] < -4 and np.hypot(*begin["tip_mm"][:2]) > 1.0
        assert total > 10
        _, total, state = episode(env, push_blindly)
        assert state["pin_n"] > 1.2 and state["tip_mm"][2] > -2 and total < -5
        return
    assert state["load_n"] == pytest.approx(1.0, abs=0.1)
    if task == "BallRolling":
        assert state["distance_mm"] < 0.5 < 3 < begin["distance_mm"]
        assert total > 10
    else:
        assert abs(state["offset_mm"]) < 1.0
        assert total > 5


@pytest.mark.parametrize("action", [[np.nan, 0, 0], [0, 0, np.inf], [0.5], 0.5])
def test_an_environment_refuses_an_action_that_is_no_number_and_leaves_its_scene(action: Any, make_env: Any) -> None:
    env = make_env("ninedtact/BallRolling-v0", sensor_folder=TWIN).unwrapped
    env.reset(seed=1)
    at_s = env.data.time
    with pytest.raises(InputError, match=r"expected an action of 3 finite numbers, got .*; correct it"):
        env.step(np.array(action, np.float32))
    assert env.data.time == at_s


@pytest.mark.interop
def test_the_peg_is_inserted_by_the_wrench_that_is_estimated_from_the_image(
    physical_sensor: SensorFolder, make_env: Any
) -> None:
    env = make_env("ninedtact/PegInsertion-v0", sensor_folder=physical_sensor, force="physics")
    of_the_gel: list[float] = []

    def insert(observation: dict[str, Any]) -> list[float]:
        wrench, gel = observation["wrench"], env.unwrapped.sensor.last.wrench
        of_the_gel.append(np.abs(wrench[:3] - gel.force_n).max())
        return insert_the_peg(observation)

    for seed in (2, 3):
        assert episode(env, insert, seed)[2]["tip_mm"][2] < -4
    assert 0 < np.mean(of_the_gel) < 0.1  # N: estimates, and good ones
    observation, _ = env.reset(seed=4)
    heights = env.unwrapped.sensor.last.heights.z_mm
    assert observation["heights"].min() == pytest.approx(heights.min(), abs=0.1)
    for options in ({"sensor_folder": TWIN, "force": "physics"}, {"sensor_folder": physical_sensor, "force": "none"}):
        with pytest.raises(InputError, match="expected force='gel', or the name of an estimator and the folder of a"):
            make_env("ninedtact/PegInsertion-v0", **options)


PAGE = (Path(__file__).parents[4] / "docs" / "simulators.md").read_text("utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
SNIPPETS = [block for block in BLOCKS if not re.search("my_sensor|torch", block)]
"""Those with a sensor folder or torch run with the examples of the Python API (`test_docs`)."""


@pytest.mark.interop
@pytest.mark.parametrize("number", range(len(SNIPPETS)))
def test_the_code_of_the_page_runs(number: int) -> None:
    exec(SNIPPETS[number], {})
