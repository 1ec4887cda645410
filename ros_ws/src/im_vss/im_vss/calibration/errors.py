"""Errors of the calibration: what makes an estimate impossible, as opposed to a verdict on one."""

from im_core.errors import DataError


class DegenerateDataError(DataError):
    """The observations cannot determine the cameras at all, so there is no estimate to judge."""

    def __init__(self, message: str, *, parameters: tuple[str, ...] = (), **facts: object) -> None:
        """Explain what is missing.

        Args:
            message: A sentence naming what is missing and what to do.
            parameters: Names of the parameters that cannot be known.
            **facts: Further figures, such as ``camera`` and ``spots``.
        """
        super().__init__(message, code="unobservable", parameters=list(parameters), **facts)
        self.parameters = parameters
