"""The record of the last seconds before an abort, as files of the results."""

from typing import TYPE_CHECKING

from im_core.errors import ImError
from im_core.names import results_dir
from im_core.ros.calls import run_in_thread
from im_mcs.client.servo_client import Reply, ServoClient
from im_mcs.servo.evidence import write_evidence

if TYPE_CHECKING:
    from im_mcs.ros.node import McsNode

FOLDER = "mcs"


async def with_evidence(node: "McsNode", client: ServoClient, reply: Reply) -> ImError:
    """The error of a reply; where it has evidence, that is written and its file named in message and facts."""
    error = reply.error
    assert error is not None
    record = client.evidence(int(reply.results.get("evidence", 0)))
    if record is None:
        return error
    try:
        path = await run_in_thread(node, write_evidence, results_dir() / FOLDER, record, error, tuple(node.model.names))
    except ImError as trouble:
        node.get_logger().warning(trouble.message)
        return error
    facts = {**error.facts, "evidence": str(path)}
    return ImError.restored(error.code, f"{error.message}; the last seconds are in {path}", facts)
