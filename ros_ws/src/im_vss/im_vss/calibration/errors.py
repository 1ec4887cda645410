"""Errors of the calibration: what makes an estimate impossible, as opposed to a verdict on one."""

from im_core.errors import DataError


class DegenerateDataError(DataError):
    """The observations cannot determine the cameras at all, so there is no estimate to judge (verdict UNOBSERVABLE).

    Args:
        message: A sentence naming what is missing and what to do.
        parameters: Names of the parameters that cannot be known.
        **facts: Further figures, such as ``camera`` and ``spots``.
    """

    default_code = "unobservable"

    def __init__(self, message: str, *, parameters: tuple[str, ...] = (), **facts: object) -> None:
        super().__init__(message, code=self.default_code, **{"parameters": list(parameters), **facts})
        self.parameters = parameters


class InconsistentDataError(DataError):
    """No camera at all explains the observations, so there is no estimate to judge (verdict MISFIT)."""

    default_code = "misfit"
