"""Faults of a control law as errors with the name: users write laws, and the servo must live."""

import numpy as np
from numpy.typing import NDArray

from im_core import plugins
from im_core.errors import FOREIGN, ImError
from im_mcs.control.controller import ControlInput, Controller, ControllerSetup
from im_mcs.limits.slots import LAW_METHODS, interface_of
from im_mcs.limits.vectors import all_finite


class ControlLawError(ImError):
    """Control law with an error, or with a wrong kind of answer."""

    default_code = "control_law"


class GuardedLaw:
    """Control law with checked answers.

    Args:
        name: ``module:Class``.
        law: The law: a :class:`Controller`, or one of velocities or positions.
    """

    def __init__(self, name: str, law: Controller) -> None:
        self._name = name
        self._law = law
        self._method = LAW_METHODS[interface_of(name)]
        self._fault: ControlLawError | None = None

    def reset(self) -> None:
        """Start anew.

        Raises:
            ControlLawError: The law raised an error.
        """
        self._fault = None
        try:
            self._law.reset()
        except FOREIGN as error:
            raise self._failed("reset", error) from error

    def hold_integral(self, hold: bool) -> None:
        """Freeze or free accumulated terms; an error of the law is raised by the next :meth:`command`."""
        try:
            self._law.hold_integral(hold)
        except FOREIGN as error:
            self._fault = self._failed("hold_integral", error)

    def command(self, given: ControlInput) -> NDArray[np.float64]:
        """Return torques, velocities or positions for the current tick, shape (n,), finite.

        Raises:
            ControlLawError: The law raised an error, or returned something else.
        """
        if self._fault is not None:
            raise self._fault
        try:
            answer = np.asarray(getattr(self._law, self._method)(given), dtype=np.float64)
        except FOREIGN as error:
            raise self._failed(self._method, error) from error
        if answer.shape != given.q.shape:
            raise ControlLawError(
                f"control law '{self._name}': {self._method} returned shape {answer.shape}, not {given.q.shape}",
                controller=self._name,
            )
        if not all_finite(answer):
            raise ControlLawError(
                f"control law '{self._name}' returned {answer[~np.isfinite(answer)][0]} as {self._method} of joint "
                f"{int(np.argmin(np.isfinite(answer))) + 1} of {len(answer)}",
                controller=self._name,
            )
        return answer

    def _failed(self, method: str, error: BaseException) -> ControlLawError:
        told = f"control law '{self._name}': {method} raised {type(error).__name__}: {error}"
        return ControlLawError(told, controller=self._name)


def load_controller(name: str, setup: ControllerSetup) -> GuardedLaw:
    """Make the control law named ``module:Class`` in the configuration.

    Raises:
        ConfigError: There is no such module or class, or it refuses its parameters; names the law.
    """
    law: Controller = plugins.make(name, "controller", setup)  # type: ignore[assignment]  # calls are guarded
    return GuardedLaw(name, law)
