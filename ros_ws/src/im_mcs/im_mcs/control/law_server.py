"""``python -m im_mcs.control.law_server``: the process of a control law; the job comes as JSON on standard input."""

import json
import sys
from typing import Any

import numpy as np

from im_cell.robot import Cell
from im_core.errors import ImError
from im_core.processes import scheduling
from im_mcs.control.controller import ControllerSetup
from im_mcs.control.guard import ControlLawError, GuardedLaw, load_controller
from im_mcs.control.link import LawLink
from im_mcs.model import ControlledModel

_ATTACH_S = 5.0
_LOOK_S = 0.5


def main() -> int:
    """Serve a law until the servo sends the end or is gone; 1 if the law cannot be made, reason in the link."""
    job: dict[str, Any] = json.load(sys.stdin)
    model = ControlledModel(Cell.model_validate(job["cell"]), job["model_error"])
    link = LawLink.attach(job["link"], LawLink.layout(model.n, len(model.wrists)), _ATTACH_S)
    try:
        laws = [_make(job["law"], model, group) for group in job["groups"]]
    except ImError as error:
        link.fault = error.message
        return 1
    scheduling.prefer(job["priority"], job["paced"])
    link.answer.post()
    serve(link, model, laws, [len(group["joints"]) for group in job["groups"]])
    return 0


def serve(link: LawLink, model: ControlledModel, laws: list[GuardedLaw], sizes: list[int]) -> None:
    """Answer questions until told to end."""
    view = link.view
    while True:
        if not link.question.wait(_LOOK_S):
            if not link.owner_alive():
                return
            continue
        if view["end"]:
            return
        group = int(view["group"])
        law, n, hold = laws[group], sizes[group], int(view["hold"])
        if not np.array_equal(model.carried, view["carried"]):
            model.carry(view["carried"].copy())
        try:
            if view["reset"]:
                law.reset()
            if hold >= 0:
                law.hold_integral(bool(hold))
            view["tau"][:n] = law.command(link.given(n))
            view["fault"][()] = b""
        except ControlLawError as fault:
            link.fault = fault.message
        link.answer.post()


def _make(law: str, model: ControlledModel, group: dict[str, Any]) -> GuardedLaw:
    setup = ControllerSetup(
        joints=np.array(group["joints"], dtype=np.intp),
        period_s=group["period_s"],
        model=model,
        torque_limit=np.array(group["torque_limit"]),
        q_nominal=model.cell.home,
        parameters=group["parameters"],
    )
    return load_controller(law, setup)


if __name__ == "__main__":
    sys.exit(main())
