"""Joint impedance: the arm as springs and dampers around the setpoint; the arm yields to a push."""

import numpy as np
import pydantic
from numpy.typing import NDArray

from im_core.config import Model as ConfigModel
from im_mcs.control.controller import ControlInput, ControllerSetup, checked
from im_mcs.control.filters import VelocityEstimator
from im_mcs.control.friction import FrictionFeedforward, FrictionParameters


class ImpedanceParameters(ConfigModel):
    """Springs and dampers."""

    stiffness: dict[str, pydantic.PositiveFloat] = pydantic.Field(
        default_factory=dict, description="by joint [Nm/rad or N/m]; of others the cell's"
    )
    damping: float = pydantic.Field(gt=0, description="1: critical, with the joint's own inertia")
    derivative_bandwidth_rad_s: float = pydantic.Field(gt=0)
    feedforward: FrictionParameters = pydantic.Field(default_factory=FrictionParameters)


class JointImpedance:
    """``tau = K e + D e' + M(q) a_d + C(q, v_d) v_d + g(q) + friction(v_d)``; no integral, by intent.

    N. Hogan, "Impedance control", J. Dyn. Sys. Meas. Control 107 (1985), in joint space and without changing the
    inertia that is felt: a torque pushes joint i away by its ``K_i``-th part. The damping of a joint with its own
    inertia ``I`` is ``D = 2 zeta sqrt(K I)``.

    Args:
        setup: Joints, model and parameters (:class:`ImpedanceParameters`).

    Raises:
        ConfigError: A parameter is missing, unknown or out of range.
    """

    def __init__(self, setup: ControllerSetup) -> None:
        parameters = checked(ImpedanceParameters, setup.parameters)
        self._model, self._joints = setup.model, setup.joints
        own, names = setup.model.cell.per_joint("stiffness"), setup.model.names
        self._stiffness = np.array([parameters.stiffness.get(names[i], own[i]) for i in setup.joints])
        inertia = setup.model.inertia_diagonal(setup.q_nominal)[setup.joints]
        self._damping = 2.0 * parameters.damping * np.sqrt(self._stiffness * inertia)
        self._rate = VelocityEstimator(len(setup.joints), setup.period_s, parameters.derivative_bandwidth_rad_s)
        self._friction = FrictionFeedforward(parameters.feedforward, setup)

    def reset(self) -> None:
        """No past."""
        self._rate.reset()

    def hold_integral(self, hold: bool) -> None:
        """Nothing accumulates."""

    def torque(self, given: ControlInput) -> NDArray[np.float64]:
        """Return torques of the wanted motion and of springs and dampers, shape (n,)."""
        error = given.setpoint.q - given.q
        wanted = given.wanted_all
        known = self._model.inverse_dynamics(given.q_all, wanted.v, wanted.a)[self._joints]
        felt = self._stiffness * error + self._damping * self._rate.update(error)
        return np.asarray(known + felt + self._friction.torque(given.setpoint.v))
