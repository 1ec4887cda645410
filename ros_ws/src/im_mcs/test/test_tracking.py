"""How well the arms follow and rest: 18 joints at once in the physics of the testbed, with friction and encoders."""

import numpy as np
import pytest

PID_GRAVITY = "im_mcs.control.pid_gravity:PidGravity"
COMPUTED_TORQUE = "im_mcs.control.computed_torque:ComputedTorque"
# Both ends of a move of more than 1 rad (1 m) in every joint, free of collisions.
START = np.array([-1.7, -0.5, -0.3, -0.6, 1.2, -2.8, -0.6, -0.7, -1.0, 0.6, 0.4, 0.3, 0.5, 1.9, -2.6, 0.6, 0.7, 1.0])
WAY = np.array([1.05, 1.2, 1.02, 1.2, 1.05, 1.2, 1.3, 1.3, 1.4, 1.05, -1.1, -1.02, -1.2, -1.05, 1.2, -1.2, -1.3, -1.4])


@pytest.fixture
def follow(config, plant_bench):
    """Moves there and back under a control law; largest true errors while moving and, of each move, at rest."""

    def follow(law, seed, **changes):
        machine = plant_bench(config.with_preset("1x18").model_copy(update=changes), seed)
        plant = machine.driver.plant
        machine.to_motion("testbed")
        assert machine.ask("set_controller", group="testbed", controller=law)["success"]
        planner, moving, resting = machine.mcs.groups["testbed"].planner, [], []
        for target in (START, START + WAY, START):
            q = plant.q

            def watch():
                nonlocal q
                if planner.setpoint.v.any():
                    moving.append(np.abs(planner.setpoint.q - q))
                q = plant.q

            reply = machine.move("testbed", target, on_tick=watch)
            assert reply["success"], reply
            resting.append(np.abs(plant.q - target))
        assert not machine.mcs.saturations.counts.any()
        return np.array(moving), np.array(resting)

    return follow


@pytest.mark.parametrize(("law", "bar"), [(PID_GRAVITY, 1e-3), (COMPUTED_TORQUE, 0.2e-3)], ids=["pid", "computed"])
def test_every_joint_follows_and_rests(follow, law, bar):
    moving, resting = follow(law, 1)
    assert moving.max() < bar
    assert resting.mean() < 0.03e-3
    assert resting.max() < 0.05e-3


def test_a_wrong_model_is_survived(follow):
    for model_error in (-0.2, 0.2):
        moving, resting = follow(COMPUTED_TORQUE, 3, model_error=model_error)
        assert moving.max() < 1e-3
        assert resting.max() < 0.1e-3
