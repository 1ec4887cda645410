"""Faults of a control law as errors with the name: users write laws, and the servo must live."""

import math

import numpy as np
from numpy.typing import NDArray

from im_core import plugins
from im_core.errors import ImError
from im_mcs.control.controller import ControlInput, Controller, ControllerSetup


class ControlLawError(ImError):
    """Control law with an error, or with a wrong kind of torque."""

    default_code = "control_law"


class GuardedLaw:
    """Control law with checked answers.

    Args:
        name: ``module:Class``.
        law: The law.
    """

    def __init__(self, name: str, law: Controller) -> None:
        self._name = name
        self._law = law
        self._fault: ControlLawError | None = None

    def reset(self) -> None:
        """Start anew.

        Raises:
            ControlLawError: The law raised an error.
        """
        self._fault = None
        try:
            self._law.reset()
        except Exception as error:
            raise self._failed("reset", error) from error

    def hold_integral(self, hold: bool) -> None:
        """Freeze or free accumulated terms; an error of the law is raised by the next :meth:`torque`."""
        try:
            self._law.hold_integral(hold)
        except Exception as error:
            self._fault = self._failed("hold_integral", error)

    def torque(self, given: ControlInput) -> NDArray[np.float64]:
        """Return torques for the current tick, shape (n,) [Nm or N], finite.

        Raises:
            ControlLawError: The law raised an error, or returned something else.
        """
        if self._fault is not None:
            raise self._fault
        try:
            tau = np.asarray(self._law.torque(given), dtype=np.float64)
        except Exception as error:
            raise self._failed("torque", error) from error
        if tau.shape != given.q.shape:
            raise ControlLawError(
                f"control law '{self._name}' returned torques of shape {tau.shape}, not {given.q.shape}",
                controller=self._name,
            )
        if not math.isfinite(tau.dot(tau)) and not np.isfinite(tau).all():  # the first is sufficient, and quick
            raise ControlLawError(
                f"control law '{self._name}' returned {tau[~np.isfinite(tau)][0]} as torque of joint "
                f"{int(np.argmin(np.isfinite(tau))) + 1} of {len(tau)}",
                controller=self._name,
            )
        return tau

    def _failed(self, method: str, error: Exception) -> ControlLawError:
        told = f"control law '{self._name}': {method} raised {type(error).__name__}: {error}"
        return ControlLawError(told, controller=self._name)


def load_controller(name: str, setup: ControllerSetup) -> Controller:
    """Make the control law named ``module:Class`` in the configuration.

    Raises:
        ConfigError: There is no such module or class, or it refuses its parameters; names the law.
    """
    law: Controller = plugins.make(name, "controller", setup)  # type: ignore[assignment]  # calls are guarded
    return GuardedLaw(name, law)
