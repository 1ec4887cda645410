"""Cartesian impedance: wrists as bodies on springs and dampers around their setpoints, pushed by a set force."""

from typing import Annotated

import numpy as np
import pinocchio as pin
import pydantic
from numpy.typing import NDArray

from im_core.config import Model as ConfigModel
from im_mcs.control.controller import ControlInput, ControllerSetup, checked
from im_mcs.control.filters import VelocityEstimator
from im_mcs.control.friction import FrictionFeedforward, FrictionParameters
from im_mcs.planning import Setpoint

# lowest inertia that a wrist is taken to have in any direction, as a share of the largest: near singularities
_LEAST = 1e-3

Axes = Annotated[list[float], pydantic.Field(min_length=3, max_length=3)]


class CartesianImpedanceParameters(ConfigModel):
    """Springs, dampers and force at the wrists."""

    translation: pydantic.PositiveFloat = pydantic.Field(description="stiffness of a wrist [N/m]")
    rotation: pydantic.PositiveFloat = pydantic.Field(description="stiffness of a wrist [Nm/rad]")
    damping: float = pydantic.Field(gt=0, description="1: critical, with the inertia that the wrist has")
    force: Axes = pydantic.Field(default=[0.0, 0.0, 0.0], description="that wrists exert, along the axes of world [N]")
    posture_rad_s: float = pydantic.Field(gt=0, description="of the joints, where they do not move a wrist")
    derivative_bandwidth_rad_s: float = pydantic.Field(gt=0)
    feedforward: FrictionParameters = pydantic.Field(default_factory=FrictionParameters)


class CartesianImpedance:
    """``tau = J' (K e + D e' + f) + N (posture) + M(q) a_d + C(q, v_d) v_d + g(q) + friction(v_d)``; no integral.

    O. Khatib, "A unified approach for motion and force control of robot manipulators", IEEE J. Robotics and Automation
    3 (1987); damping by A. Albu-Schaeffer et al., "Cartesian impedance control of redundant robots", ICRA 2003: ``D``
    damps every direction alike with the inertia ``(J M^-1 J')^-1`` of the wrist. ``N`` lets the springs of the posture
    move no wrist. A group without a wrist has only these.

    Args:
        setup: Joints, model and parameters (:class:`CartesianImpedanceParameters`).

    Raises:
        ConfigError: A parameter is missing, unknown or out of range.
    """

    def __init__(self, setup: ControllerSetup) -> None:
        parameters = checked(CartesianImpedanceParameters, setup.parameters)
        self._model, self._joints = setup.model, setup.joints
        tips = {group.tip for group in setup.model.cell.groups.values()}
        self._wrists = sorted(tip for tip in tips if setup.model.joints_below(tip)[-1] in setup.joints)
        spring = [parameters.translation] * 3 + [parameters.rotation] * 3
        self._stiffness = np.array(spring * len(self._wrists))
        self._force = np.array([*parameters.force, 0.0, 0.0, 0.0] * len(self._wrists))
        self._damping, self._posture = parameters.damping, parameters.posture_rad_s
        self._rate = VelocityEstimator(len(setup.joints), setup.period_s, parameters.derivative_bandwidth_rad_s)
        self._friction = FrictionFeedforward(parameters.feedforward, setup)

    def reset(self) -> None:
        """No past."""
        self._rate.reset()

    def hold_integral(self, hold: bool) -> None:
        """Nothing accumulates."""

    def torque(self, given: ControlInput) -> NDArray[np.float64]:
        """Return torques of the wanted motion, of springs and dampers, and of the force, shape (n,)."""
        model, joints, wanted = self._model, self._joints, given.wanted_all
        error = given.setpoint.q - given.q
        rate = self._rate.update(error)
        inertia = model.inertia(given.q_all)[np.ix_(joints, joints)]
        known = model.inverse_dynamics(given.q_all, wanted.v, wanted.a)[joints]
        posture = inertia @ (self._posture**2 * error + 2.0 * self._posture * rate)
        if self._wrists:
            jacobian = np.vstack([model.jacobian(given.q_all, wrist)[:, joints] for wrist in self._wrists])
            mobility = np.linalg.solve(inertia, jacobian.T)
            felt = _inverse(jacobian @ mobility)
            pull = self._stiffness * self._offs(given.q_all, wanted) + self._force
            pull += self._damper(felt) @ (jacobian @ rate)
            posture = posture - jacobian.T @ (felt @ (mobility.T @ posture)) + jacobian.T @ pull
        return np.asarray(known + posture + self._friction.torque(given.setpoint.v))

    def _offs(self, q: NDArray[np.float64], wanted: Setpoint) -> NDArray[np.float64]:
        """Return way and turn from each wrist to its setpoint, along the axes of world, shape (6 w,) [m, rad]."""
        offs = []
        for wrist in self._wrists:
            there, here = self._model.pose(wanted.q, wrist), self._model.pose(q, wrist)
            offs += [there.translation - here.translation, pin.log3(there.rotation @ here.rotation.T)]
        return np.concatenate(offs)

    def _damper(self, felt: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the damping of the wrists, shape (6 w, 6 w), by double diagonalisation of inertia and stiffness."""
        lower = np.linalg.cholesky(felt)
        turned = np.linalg.solve(lower, np.linalg.solve(lower, np.diag(self._stiffness)).T)
        frequencies, modes = np.linalg.eigh(turned)
        shape = lower @ modes
        rates = 2.0 * self._damping * np.sqrt(np.maximum(frequencies, 0.0))
        return np.asarray((shape * rates) @ shape.T)


def _inverse(mobility: NDArray[np.float64]) -> NDArray[np.float64]:
    """Invert a symmetric matrix whose directions of little motion count as of some."""
    values, vectors = np.linalg.eigh(mobility)
    return np.asarray((vectors / np.maximum(values, _LEAST * values[-1])) @ vectors.T)
