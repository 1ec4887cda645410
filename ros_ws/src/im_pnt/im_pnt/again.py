"""Functions that may be done twice: whether one was done is answered by doing it again."""

import inspect
from collections.abc import Callable

from im_core.errors import ImError
from im_pnt.doubt import Answer, Verdict
from im_pnt.functions import ActionContext, AskFunction


def again(function: Callable[[ActionContext], object]) -> AskFunction:
    """Returns what is to be asked about an action whose function has the same effect however often it is done."""

    async def ask(context: ActionContext) -> Answer:
        try:
            outcome = function(context)
            if inspect.isawaitable(outcome):
                await outcome
        except ImError as error:
            return Answer(Verdict.FAILED, error, asked="it was done again")
        return Answer(Verdict.DONE, asked="it was done again")

    return ask
