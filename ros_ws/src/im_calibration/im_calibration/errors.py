"""Errors of the calibration: reasons why an estimate is impossible, as opposed to verdicts on an estimate."""

from im_core.errors import DataError

_ADVICE = "Check that the spots belong to these poses, and the units and axes of the data [m, px]."


class DegenerateDataError(DataError):
    """The observations cannot determine the cameras at all, so there is no estimate to judge (verdict UNOBSERVABLE).

    Args:
        reason: A sentence naming what is missing.
        advice: A sentence saying what to do about it.
        parameters: Names of the parameters that cannot be known.
        **facts: Further figures, such as ``camera`` and ``spots``.
    """

    default_code = "unobservable"

    def __init__(self, reason: str, advice: str, *, parameters: tuple[str, ...] = (), **facts: object) -> None:
        super().__init__(f"{reason} {advice}", code=self.default_code, **{"parameters": list(parameters), **facts})
        self.reason = reason
        self.advice = advice
        self.parameters = parameters


class InconsistentDataError(DataError):
    """No camera at all explains the observations, so there is no estimate to judge (verdict MISFIT).

    Args:
        reason: A sentence naming what cannot be explained.
        advice: A sentence saying what to do about it.
        camera: Name of the camera; empty: it is not one alone.
    """

    default_code = "misfit"

    def __init__(self, reason: str, advice: str = _ADVICE, *, camera: str = "") -> None:
        self.reason = reason
        self.advice = advice
        super().__init__(f"{self.reason} {self.advice}", code=self.default_code, camera=camera)
        self.parameters: tuple[str, ...] = ()
