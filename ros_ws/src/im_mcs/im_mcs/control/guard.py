"""What a control law does wrong becomes an error that names it: others write laws, and the servo must live."""

import math
from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from im_core import plugins
from im_core.errors import ConfigError, ImError
from im_mcs.control.controller import ControlInput, Controller, ControllerSetup

ResultT = TypeVar("ResultT")


class ControlLawError(ImError):
    """A control law raised an error, or returned what is no torque."""

    default_code = "control_law"


class GuardedLaw:
    """A control law whose answers are checked.

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
        self._run("reset", self._law.reset)

    def hold_integral(self, hold: bool) -> None:
        """Freeze or free what accumulates; if the law raises an error, the next :meth:`torque` does."""
        try:
            self._run("hold_integral", lambda: self._law.hold_integral(hold))
        except ControlLawError as fault:
            self._fault = fault

    def torque(self, given: ControlInput) -> NDArray[np.float64]:
        """Torques for this tick, shape (n,) [Nm or N], finite.

        Raises:
            ControlLawError: The law raised an error, or returned something else.
        """
        if self._fault is not None:
            raise self._fault
        tau = self._run("torque", lambda: np.asarray(self._law.torque(given), dtype=np.float64))
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

    def _run(self, method: str, call: Callable[[], ResultT]) -> ResultT:
        try:
            return call()
        except Exception as error:
            raise ControlLawError(
                f"control law '{self._name}': {method} raised {type(error).__name__}: {error}", controller=self._name
            ) from error


def load_controller(name: str, setup: ControllerSetup) -> Controller:
    """Make the control law that the configuration names ``module:Class``.

    Raises:
        ConfigError: There is no such module or class, or it refuses its parameters.
    """
    factory = plugins.load(name, None, "controller")
    try:
        if not callable(factory):
            raise TypeError("it is no class")
        return GuardedLaw(name, factory(setup))
    except ImError:
        raise
    except Exception as error:  # a law of the user's may raise anything
        sentence = f"controller '{name}' cannot be loaded: {type(error).__name__}: {error}"
        raise ConfigError(sentence, controller=name) from error
